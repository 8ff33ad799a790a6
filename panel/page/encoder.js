// A wheel that turns the drive's encoder: by dragging, by keys, or a number of counts at a rate.

import { attr, button, card, el, svg, text } from "./dom.js";
import { number } from "./format.js";

const PER_TURN = 100; // counts of a turn of the wheel
const EVERY = 60; // milliseconds between two calls while it is dragged

export function encoderCard(app, drive) {
  let angle = 0, waiting = 0, turned = 0, busy = false, grabbed = null;
  const path = `drives/${encodeURIComponent(drive)}/encoder`;

  const knob = svg("g", {}, svg("circle", { r: 44, class: "knob" }),
    ...Array.from({ length: 36 }, (_, i) => svg("line", { x1: 0, x2: 0, y1: -44, y2: -39, class: "grip", transform: `rotate(${i * 10})` })),
    svg("circle", { r: 5, cy: -27, class: "dimple" }));
  const wheel = svg("svg", {
    viewBox: "-50 -50 100 100", class: "wheel", tabindex: 0, role: "slider", "aria-label": "Encoder wheel", "aria-valuenow": 0, "aria-valuemin": -1e6, "aria-valuemax": 1e6,
  }, knob);
  const shown = el("output", { class: "turned" }, "0 counts");

  const turn = counts => {
    waiting += counts;
    turned += counts;
    angle += counts * 360 / PER_TURN;
    attr(knob, "transform", `rotate(${angle % 360})`);
    attr(wheel, "aria-valuenow", turned);
    attr(wheel, "aria-valuetext", `${turned} counts`);
    text(shown, `${number(turned)} counts`);
    send();
  };
  const send = async () => {
    if (busy || !waiting) return;
    busy = true;
    const counts = waiting;
    waiting = 0;
    // Fast enough to be over before the next call; a call that comes too early is refused with 409 and tried again.
    const answer = await app.backend.call("POST", path, { counts, hz: Math.max(1000, Math.abs(counts) * 40) });
    if (answer.status === 409) waiting += counts;
    else if (!answer.ok) app.say(answer.body?.detail ?? "The encoder cannot be turned.");
    setTimeout(() => {
      busy = false;
      send();
    }, EVERY);
  };
  const at = event => {
    const box = wheel.getBoundingClientRect();
    return Math.atan2(event.clientY - box.top - box.height / 2, event.clientX - box.left - box.width / 2);
  };
  let rest = 0;
  wheel.addEventListener("pointerdown", event => {
    wheel.setPointerCapture(event.pointerId);
    grabbed = at(event);
    rest = 0;
  });
  wheel.addEventListener("pointermove", event => {
    if (grabbed === null) return;
    const now = at(event);
    let moved = now - grabbed;
    if (moved > Math.PI) moved -= 2 * Math.PI;
    if (moved < -Math.PI) moved += 2 * Math.PI;
    grabbed = now;
    rest += moved / (2 * Math.PI) * PER_TURN;
    const counts = Math.trunc(rest);
    rest -= counts;
    if (counts) turn(counts);
  });
  for (const name of ["pointerup", "pointercancel"]) wheel.addEventListener(name, () => { grabbed = null; });
  wheel.addEventListener("keydown", event => {
    const counts = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1, PageUp: PER_TURN, PageDown: -PER_TURN }[event.key];
    if (!counts) return;
    event.preventDefault();
    turn(counts);
  });

  const counts = el("input", { type: "number", step: 1, value: 4000, class: "small", "aria-label": "Counts" });
  const rate = el("input", { type: "number", min: 0.001, step: "any", value: 2000, class: "small", "aria-label": "Counts per second" });
  const go = button("Turn", { "data-action": "encoder" }, () => app.act("POST", path, { counts: Math.round(Number(counts.value)), hz: Number(rate.value) }));
  const form = el("div", { class: "row" }, el("label", {}, counts, " counts at "), el("label", {}, rate, " Hz"), go);
  return { node: card("Encoder", { class: "encoder" }, null, el("div", { class: "wheel-row" }, wheel, el("div", {}, shown, el("p", { class: "hint" }, "Drag the wheel, or use the arrow keys: a count each, page up and down a turn of 100."))), form) };
}
