// A terminal on a text port of a drive: a client like any other, connected only when one asks for it.

import { attr, button, card, el, text } from "./dom.js";

const KEPT = 40_000; // characters

/** The ports of a kind that talk text. */
export const textPorts = kind => kind.ports.filter(port => /carriage return|end character/.test(port.message_ends)).map(port => port.name);

export function terminalCard(app, drive, kind, port) {
  const isMcode = port === "mcode";
  let session = null, history = [], place = 0, shown = "", dirty = false;
  const output = el("pre", { class: "screen", tabindex: 0, role: "log", "aria-label": "What the drive has sent" });
  const hint = isMcode ? "PR P" : "R0E";
  const input = el("input", { placeholder: `for example ${hint}`, "aria-label": `Text to ${port}`, autocomplete: "off", spellcheck: "false", autocapitalize: "characters" });
  const send = button("Send", { class: "primary", "data-action": "terminal-send" }, () => say(`${input.value}\r`));
  const stop = button(isMcode ? "Esc" : "Stop", { class: "ghost", title: isMcode ? "Escape: stops motion and program" : "Sends an empty command" }, () => say(isMcode ? "\x1b" : "\r", false));
  const connect = button("Connect", { "data-action": "terminal" }, () => (session ? close() : open()));
  const state = el("span", { class: "hint" });
  const form = el("div", { class: "row prompt" }, input, send, stop);
  const note = el("p", { class: "hint" }, isMcode ? "A client of the MCode port, as by TCP." : "A client of the USB port. Opening it resets the QSB, as on the real one.");
  const node = card(`Terminal ${port}`, { class: "terminal", id: `terminal-${port}` }, el("div", { class: "tools" }, state, connect), note, output, form);

  const draw = () => {
    dirty = false;
    const follow = output.scrollTop + output.clientHeight >= output.scrollHeight - 20;
    text(output, shown);
    if (follow) output.scrollTop = output.scrollHeight;
  };
  const add = words => {
    shown = (shown + words.replace(/\r\n?/g, "\n").replace(/\n\n(?=.)/g, "\n").replace(/[\0-\x08\x0b-\x1f]/g, mark => String.fromCharCode(0x2400 + mark.charCodeAt(0)))).slice(-KEPT);
    if (!dirty) {
      dirty = true;
      requestAnimationFrame(draw);
    }
  };
  const connected = yes => {
    form.hidden = output.hidden = yes !== true && shown === "";
    input.disabled = send.disabled = stop.disabled = yes !== true;
    text(connect, yes === true ? "Disconnect" : "Connect");
    attr(connect, "aria-pressed", yes === true);
    text(state, yes === true ? "connected" : typeof yes === "string" ? yes : "");
    note.hidden = yes === true;
  };
  const open = () => {
    session = app.backend.terminal(drive, port, add, yes => {
      if (yes !== true) session = null;
      connected(yes);
      if (yes === true) input.focus();
    });
    form.hidden = output.hidden = false;
  };
  const close = () => {
    session?.close();
    session = null;
  };
  const say = async (words, keep = true) => {
    if (!session) return;
    if (keep && input.value) history = [...history.slice(-99), input.value];
    place = history.length;
    if (keep) input.value = "";
    const answer = await session.send(words);
    if (!answer.ok) app.say(answer.body?.detail ?? "The text could not be sent.");
  };
  input.addEventListener("keydown", event => {
    if (event.key === "Enter") send.click();
    const step = { ArrowUp: -1, ArrowDown: 1 }[event.key];
    if (!step) return;
    event.preventDefault();
    place = Math.max(0, Math.min(history.length, place + step));
    input.value = history[place] ?? "";
  });
  connected(false);
  return { node, close };
}
