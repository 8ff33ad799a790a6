// The front of a drive: its lights, and its connectors with the level of each contact and switches for the inputs.

import { attr, el, text } from "./dom.js";
import { colorOf, faceOf } from "./faces.js";
import { contact, levelOf } from "./pins.js";

export function face(app, drive, kind, state) {
  const front = faceOf(kind, Object.keys(state.pins));
  const lights = new Map(), contacts = new Map();

  const leds = Object.keys(state.leds).sort((a, b) => keyOf(front, a) - keyOf(front, b)).map(name => {
    const [label, color] = front.leds[name] ?? [name, undefined];
    const words = el("span", { class: "visually-hidden" });
    const light = el("span", { class: `led ${colorOf(name, color)}`, "data-led": name }, el("i", { "aria-hidden": "true" }), el("b", {}, name), label.toUpperCase() === name ? null : el("span", {}, label), words);
    lights.set(name, { light, words });
    return light;
  });
  const connectors = front.connectors.map(connector => el("div", { class: "connector", role: "group", "aria-label": `Connector ${connector.name}` },
    el("h3", {}, el("b", {}, connector.name), el("span", {}, connector.title)),
    connector.contacts.length === 0 ? null : el("ul", {}, connector.contacts.map(([number, label, pin]) => {
      const entry = contact(app, drive, { number, label, pin, role: roleOf(kind, pin) });
      if (pin) contacts.set(pin, entry);
      return entry.node;
    }))));
  const node = el("section", { class: "face", "aria-label": "Front of the drive" },
    el("header", {}, el("div", { class: "plate" }, el("h2", {}, front.title), el("p", {}, front.maker)), el("div", { class: "leds" }, leds)),
    el("div", { class: "connectors" }, connectors));

  return {
    node,
    update({ changes, whole }) {
      const now = app.store.state.drive;
      const changed = whole ? now : changes.drive ?? {};
      for (const name of Object.keys(changed.leds ?? {})) {
        const entry = lights.get(name);
        if (!entry || now.leds[name] === undefined) continue;
        attr(entry.light, "data-state", now.leds[name] ? "on" : "off");
        text(entry.words, now.leds[name] ? "on" : "off");
      }
      for (const name of Object.keys(changed.pins ?? {})) contacts.get(name)?.update(levelOf(now.pins[name]));
      attr(node, "data-state", now.powered ? "on" : "off");
    },
  };
}

const keyOf = (front, led) => (Object.keys(front.leds).indexOf(led) + 99) % 99;
const roleOf = (kind, name) => kind.pins.find(pin => pin.name === name || pin.aliases?.includes(name))?.role ?? "";
