// A bench in WebAssembly, which this page runs: no server. The interface is that of backend.js, with `begin` and `buttons` besides.

import { load } from "./module.js";
import { buttonsCard } from "./buttons.js";
import { notes } from "./notes.js";

const PACE = 1000 / 30 - 4; // shortest time between two updates, in milliseconds: each second one of 60 frames a second
const SLICE = 1; // milliseconds for which the bench runs at once
const BUDGET = 24; // milliseconds of each frame that the bench may take
const LONGEST = 250; // most milliseconds that the bench makes up for after a break
const STARTED = 3; // seconds of bench time after which every drive has started

let wasm = null, broken = null;
let follower = null; // whoever follows the bench: {drive, onUpdate, onConnection, whole}
let looked = 0, updated = 0; // times of the last look at the bench, and of the last update
const terminals = new Set();

const encoder = new TextEncoder(), decoder = new TextDecoder();

/** Puts text where the bench reads arguments; returns its length. */
function put(words) {
  const bytes = encoder.encode(words);
  const place = wasm.reserve(bytes.length);
  new Uint8Array(wasm.memory.buffer, place, bytes.length).set(bytes);
  return bytes.length;
}

/** A copy of what the bench has put out. */
const output = () => new Uint8Array(wasm.memory.buffer, wasm.output(), wasm.output_length()).slice();

/** Makes a call: {ok, status, bytes}. */
function ask(method, path, body) {
  const status = wasm.call(put(JSON.stringify({ method, path: path.split("/").map(decodeURIComponent), body })));
  return { ok: status < 400, status, bytes: output() };
}

function answer(method, path, body) {
  const { ok, status, bytes } = ask(method, path, body);
  return { ok, status, body: bytes.length && status !== 204 ? JSON.parse(decoder.decode(bytes)) : null };
}

/** Runs `act` on the bench, which may break down. */
async function safely(act) {
  try {
    await ready;
    return await act();
  } catch (error) {
    fail(error);
    return { ok: false, status: 0, body: { detail: broken } };
  }
}

function fail(error) {
  broken ??= wasm ? `The bench has broken down (${error.message}): reload the page` : `The bench could not be loaded (${error.message}): reload the page`;
  // In the place of the page's sentence that it connects, which nothing would end.
  document.getElementById("content").dataset.broken = broken;
  follower?.onConnection(broken);
}

/** Begins the bench anew, at a time at which its drives have started. */
function start(file) {
  if (!wasm.start(put(file))) throw new Error(decoder.decode(output()));
  for (let passed = 0; passed < STARTED * 1000; passed += LONGEST) wasm.pass(LONGEST / 1000);
}

let file = "";
const ready = load().then(loaded => {
  file = loaded.bench;
  wasm = loaded.exports;
  start(file);
  before = performance.now();
  requestAnimationFrame(tick);
});
ready.catch(fail);

// --- Time ---

let before = 0, wasHidden = document.hidden;
document.addEventListener("visibilitychange", () => document.hidden && (wasHidden = true));

/** Lets the bench's time pass as the browser's, and shows what has happened. A hidden page gets no frames: the bench stands still. */
function tick() {
  if (broken) return;
  requestAnimationFrame(tick);
  const now = performance.now(), passed = now - before;
  before = now;
  let news = null;
  try {
    run(now, passed);
    news = look(now);
    for (const terminal of terminals) terminal.read();
  } catch (error) {
    return fail(error);
  }
  if (!news) return;
  const { whole } = follower;
  follower.whole = false;
  if (whole) follower.onConnection(true);
  follower.onUpdate(news, whole);
}

function run(now, passed) {
  const due = Math.min(passed, LONGEST);
  let done = 0;
  while (done < due && performance.now() - now < BUDGET) {
    const slice = Math.min(SLICE, due - done);
    wasm.pass(slice / 1000);
    done += slice;
  }
  notes.ran(done, passed, wasHidden);
  wasHidden = false;
}

/** What has changed since the last update; null if nothing has, or it is too early. */
function look(now) {
  if (!follower || now - looked < PACE) return null;
  looked = now;
  if (!wasm.update(now - updated)) return null;
  updated = now;
  return JSON.parse(decoder.decode(output()));
}

// --- The interface ---

/** A long advance goes in steps of a second, so that the page does not hang. */
async function advance(body) {
  let left = body.seconds, paused = performance.now();
  while (left > 1 && left <= 86_400) {
    const step = answer("POST", "time/advance", { seconds: 1 });
    if (!step.ok) return step;
    left -= 1;
    if (performance.now() - paused > 30) {
      await new Promise(resolve => setTimeout(resolve));
      paused = performance.now();
    }
  }
  return answer("POST", "time/advance", { ...body, seconds: left });
}

function call(method, path, body) {
  return safely(() => (path === "time/advance" && body?.seconds > 1 ? advance(body) : answer(method, path, body)));
}

function follow(drive, onUpdate, onConnection) {
  const mine = { drive, onUpdate, onConnection, whole: true };
  follower = mine;
  if (broken) onConnection(broken);
  safely(() => follower === mine && wasm.follow(put(drive ?? "")));
  return () => {
    if (follower === mine) follower = null;
  };
}

function download(format) {
  return safely(() => {
    const { ok, bytes } = ask("GET", `trace/${format}`);
    return ok ? { ok, name: `drivetwin.${format}`, blob: new Blob([bytes]) } : { ok, body: JSON.parse(decoder.decode(bytes)) };
  });
}

function terminal(drive, port, onText, onState) {
  let path = null;
  const end = why => {
    terminals.delete(mine);
    path = null;
    onState(why);
  };
  const mine = {
    end,
    read() {
      const { ok, body } = answer("GET", path);
      if (ok && body.text) onText(body.text);
      if (!ok || body.ended) end("The port has closed the connection.");
    },
  };
  safely(() => {
    const { ok, body } = answer("POST", `drives/${encodeURIComponent(drive)}/ports/${port}/terminal`);
    if (!ok) return onState(body.detail);
    path = `terminals/${body.id}`;
    terminals.add(mine);
    onState(true);
  });
  return {
    send: async text => (path ? call("POST", path, { text }) : { ok: false, body: { detail: "The terminal is not connected." } }),
    close() {
      if (path) answer("DELETE", path);
      end(false);
    },
  };
}

/** Begins again, with the bench as it was at first. */
function restart() {
  return safely(() => {
    for (const terminal of terminals) terminal.end("The bench has begun again.");
    start(file);
    if (!follower) return { ok: true };
    follower.whole = true;
    wasm.follow(put(follower.drive ?? ""));
    return { ok: true };
  });
}

export const bench = {
  call, follow, download, terminal,
  /** Gives the site the frame of the page, which shows a drive at first. */
  begin(app) {
    notes.begin(app);
    safely(() => {
      const { body } = answer("GET", "bench");
      if (location.hash === "") location.replace(`#/${body.drives[0].name}`);
    });
  },
  /** The card with the buttons of a drive. */
  buttons: (app, drive) => buttonsCard(app, drive, restart),
};
