// A bench behind the control API: fetch for calls, server-sent events for what happens.

const SLOWEST_RETRY = 4000;
const QUIET = 1000; // milliseconds without an update after which the bench is asked whether it is there
const HUNG = 3000; // milliseconds without a word after which it is said to hang

async function call(method, path, body) {
  let response;
  try {
    response = await fetch(`api/${path}`, {
      method,
      headers: method === "GET" ? {} : { "Content-Type": "application/json" },
      body: body === undefined ? undefined : JSON.stringify(body),
    });
  } catch {
    return { ok: false, status: 0, body: { detail: "The bench does not answer." } };
  }
  const words = await response.text();
  let parsed = null;
  try {
    parsed = words === "" ? null : JSON.parse(words);
  } catch {
    parsed = { detail: words };
  }
  return { ok: response.ok, status: response.status, body: parsed };
}

/** Why a stream of events cannot be had: an EventSource does not tell. Null if the bench does not answer, or now would. */
async function refusalOf(path) {
  const abort = new AbortController();
  try {
    const response = await fetch(path, { signal: abort.signal });
    if (!response.ok) return { status: response.status, detail: (await response.json()).detail };
  } catch {
    // No answer, or none in JSON: there is no reason to show.
  } finally {
    abort.abort();
  }
  return null;
}

function follow(drive, onUpdate, onConnection) {
  const path = drive === null ? "api/live" : `api/live?drive=${encodeURIComponent(drive)}`;
  let source, retry, stopped = false, wait = 250;
  let heard = null, isHung = false; // time of the last word; null while there is no connection
  const hear = () => {
    if (heard === null) return;
    heard = performance.now();
    if (isHung) onConnection(true);
    isHung = false;
  };
  // A bench that hangs keeps its connections, and one whose time stands sends nothing: only an answer tells them apart.
  const abort = new AbortController();
  let isAsked = false;
  const ask = async () => {
    if (isAsked) return;
    isAsked = true;
    try {
      await fetch(drive === null ? "api/buses" : `api/drives/${encodeURIComponent(drive)}`, { signal: abort.signal });
      hear();
    } catch {
      // The stream tells of a lost connection.
    }
    isAsked = false;
  };
  const watch = setInterval(() => {
    const quiet = heard === null ? 0 : performance.now() - heard;
    isHung = quiet >= HUNG;
    if (isHung) onConnection(`No answer for ${Math.floor(quiet / 1000)} s`);
    if (quiet >= QUIET) ask();
  }, QUIET / 2);
  const connect = () => {
    let whole = true;
    heard = performance.now();
    source = new EventSource(path);
    source.addEventListener("update", event => {
      wait = 250;
      hear();
      if (whole) onConnection(true);
      onUpdate(JSON.parse(event.data), whole);
      whole = false;
    });
    source.addEventListener("error", async () => {
      source.close();
      const refusal = await refusalOf(path);
      if (stopped) return;
      heard = null;
      isHung = false;
      if (refusal?.status === 404 || refusal?.status === 422) return onConnection(refusal.detail, true); // no such drive
      onConnection(refusal ? `${refusal.detail}; trying again` : "Connection lost; trying again");
      retry = setTimeout(connect, wait);
      wait = Math.min(2 * wait, SLOWEST_RETRY);
    });
  };
  connect();
  return () => {
    stopped = true;
    clearTimeout(retry);
    clearInterval(watch);
    abort.abort();
    source.close();
  };
}

async function download(format) {
  let response;
  try {
    response = await fetch(`api/trace?format=${format}`);
    if (response.ok) return { ok: true, name: `drivetwin.${format}`, blob: await response.blob() };
    return { ok: false, body: await response.json() };
  } catch {
    return { ok: false, body: { detail: "The bench does not answer." } };
  }
}

function terminal(drive, port, onText, onState) {
  const path = `api/drives/${encodeURIComponent(drive)}/ports/${port}/terminal`;
  const source = new EventSource(path);
  let id = null;
  source.addEventListener("open", event => {
    if (!event.data) return; // the connection itself; the server's event `open` has the number of the client
    id = JSON.parse(event.data).id;
    onState(true);
  });
  source.addEventListener("text", event => onText(JSON.parse(event.data).text));
  source.addEventListener("error", async () => {
    source.close();
    const wasOpen = id !== null;
    id = null;
    onState(wasOpen ? "The port has closed the connection." : (await refusalOf(path))?.detail ?? "The port cannot be opened.");
  });
  return {
    send: text => (id === null ? { ok: false, body: { detail: "The terminal is not connected." } }
      : call("POST", `terminals/${id}`, { text })),
    close: () => {
      source.close();
      onState(false);
    },
  };
}

export const http = { call, follow, download, terminal };
