// Contacts of a connector as switches that one can press.

import { attr, button, el, text } from "./dom.js";

/** The buttons that this page pressed, by the path of the pin: the bench tells the level of a pin, and not what drives it. */
const pressed = new Map();

/** A level as the API shows it: low, high or open. */
export const levelOf = level => (typeof level === "string" ? level : level === null || level === undefined ? "open" : String(level));

export function contact(app, drive, { number, label, pin, role }) {
  const dot = el("i", { class: "contact", "aria-hidden": "true" });
  const place = el("span", { class: "number" }, number ?? "");
  const words = el("span", { class: "label" }, label, pin && !label.includes(pin) ? el("code", {}, pin) : null);
  if (!pin) return { node: el("li", { class: "wired" }, place, dot, words) };

  const path = `drives/${encodeURIComponent(drive)}/pins/${encodeURIComponent(pin)}`;
  const level = el("span", { class: "level" });
  const isInput = /input/.test(role), isAnalogue = /analogue/.test(role) && /^(ANALOG|SPEED)/.test(pin);
  const buttons = !isInput ? [] : ["low", "high", "open"].map(name =>
    button(name, { "data-set": name, "aria-label": `${pin} ${name}` }, async () => (await app.act("PUT", path, { level: name })).ok && press(name)));
  /** Shows what drives the pin: a button, or null for something else. */
  const press = name => {
    pressed.set(path, name);
    for (const control of buttons) attr(control, "aria-pressed", control.dataset.set === name);
  };
  const switches = isInput ? el("span", { class: "segments pin-switch", role: "group", "aria-label": `Drive ${pin}` }, buttons) : null;
  const node = el("li", { "data-pin": pin, title: role }, place, dot, words, level, ...(switches ? [switches] : []));
  if (isAnalogue) node.append(analogue(app, pin, path, /mA/.test(role), () => press(null)));
  press(pressed.get(path) ?? null);
  return {
    node,
    update(state) {
      attr(node, "data-state", state);
      text(level, state);
      const own = pressed.get(path);
      if (own && own !== "open" && own !== state) press(null); // somebody else drives it
    },
  };
}

/** A voltage, and for inputs that measure one a current. */
function analogue(app, pin, path, hasCurrent, onSet) {
  const range = el("input", { type: "range", min: 0, max: hasCurrent ? 10 : 5, step: 0.05, value: 0, "aria-label": `Voltage at ${pin}` });
  const shown = el("span", { class: "shown" }, "– V");
  const set = async body => (await app.act("PUT", path, body)).ok && onSet();
  range.addEventListener("input", () => text(shown, `${Number(range.value).toFixed(2)} V`));
  range.addEventListener("change", () => set({ volts: Number(range.value) }));
  const node = el("span", { class: "analogue" }, range, shown);
  if (hasCurrent) {
    const current = el("input", { type: "number", min: 0, max: 20, step: 0.1, value: 4, class: "tiny", "aria-label": `Current into ${pin} in mA` });
    current.addEventListener("change", () => set({ milliamps: Number(current.value) }));
    node.append(el("label", {}, current, " mA"));
  }
  return node;
}
