// Pulses into an input: a number of them at a rate.

import { button, card, el } from "./dom.js";

export function pulsesCard(app, drive, kind, pins) {
  const inputs = kind.pins.filter(pin => /input/.test(pin.role) && pins[pin.name] !== undefined).map(pin => pin.name);
  if (inputs.length === 0) return null;
  const pin = el("select", { "aria-label": "Input that gets the pulses" }, inputs.map(name => el("option", { value: name }, name)));
  const count = el("input", { type: "number", min: 1, step: 1, value: 100, class: "small", "aria-label": "Number of pulses" });
  const rate = el("input", { type: "number", min: 0.000001, step: "any", value: 1000, class: "small", "aria-label": "Pulses per second" });
  const go = button("Send", { "data-action": "pulses" }, () =>
    app.act("POST", `drives/${encodeURIComponent(drive)}/pins/${encodeURIComponent(pin.value)}/pulses`, { count: Math.round(Number(count.value)), hz: Number(rate.value) }));
  return { node: card("Pulses", { class: "pulses" }, null, el("div", { class: "row" }, pin, el("label", {}, count, " at "), el("label", {}, rate, " Hz"), go)) };
}
