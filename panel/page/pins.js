// Contacts of a connector as switches that one can press.

import { attr, button, el, text } from "./dom.js";

/** A level as the API shows it: low, high or open. */
export const levelOf = level => (typeof level === "string" ? level : level === null || level === undefined ? "open" : String(level));

export function contact(app, drive, { number, label, pin, role }) {
  const dot = el("i", { class: "contact", "aria-hidden": "true" });
  const place = el("span", { class: "number" }, number ?? "");
  const words = el("span", { class: "label" }, label, pin && !label.includes(pin) ? el("code", {}, pin) : null);
  if (!pin) return { node: el("li", { class: "wired" }, place, dot, words) };

  const path = `drives/${encodeURIComponent(drive)}/pins/${encodeURIComponent(pin)}`;
  const level = el("output", { class: "level", "aria-label": `Level of ${pin}` });
  const isInput = /input/.test(role), isAnalogue = /analogue/.test(role) && /^(ANALOG|SPEED)/.test(pin);
  const buttons = !isInput ? [] : ["low", "high", "open"].map(name =>
    button(name, { "data-set": name, "aria-label": `${pin} ${name}` }, () => app.act("PUT", path, { level: name })));
  const switches = isInput ? el("span", { class: "segments pin-switch", role: "group", "aria-label": `Drive ${pin}` }, buttons) : null;
  const node = el("li", { "data-pin": pin, title: role }, place, dot, words, switches ?? level);
  if (isInput) node.append(el("span", { class: "visually-hidden" }, level));
  if (isAnalogue) node.append(analogue(app, pin, path, /mA/.test(role)));
  return {
    node,
    update(state) {
      attr(node, "data-state", state);
      text(level, state);
      for (const control of buttons) attr(control, "aria-pressed", control.dataset.set === state);
    },
  };
}

/** A voltage, and for inputs that measure one a current. */
function analogue(app, pin, path, hasCurrent) {
  const range = el("input", { type: "range", min: 0, max: hasCurrent ? 10 : 5, step: 0.05, value: 0, "aria-label": `Voltage at ${pin}` });
  const shown = el("output", {}, "– V");
  const set = body => app.act("PUT", path, body);
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
