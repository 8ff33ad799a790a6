// The fields of a register: their meaning in words, and a control for each.

import { attr, el, text } from "./dom.js";
import { hex } from "./format.js";

const rangeOf = field => {
  const [high, low = high] = String(field.bits).split(":").map(Number);
  return { low, size: 2 ** (high - low + 1), isBit: high === low };
};

const partOf = (value, { low, size }) => Math.floor((value < 0 ? value >>> 0 : value) / 2 ** low) % size;

/** The value of a register in words: bits that are set, and fields with the words for their values. */
export function meaning(fields, value) {
  return fields.flatMap(field => {
    const range = rangeOf(field), part = partOf(value, range);
    const word = field.values?.[part];
    if (range.isBit && !word) return part ? [field.name] : [];
    if (!field.name) return word ? [word] : []; // the register as a whole
    return [`${field.name}: ${word ?? part}`];
  }).join(" · ");
}

/** Controls of the fields; a change gives the new value of the register to `onChange`. */
export function fieldList(name, fields, onChange) {
  let value = 0;
  const rows = fields.map(field => {
    const range = rangeOf(field);
    const set = part => onChange(value + (part - partOf(value, range)) * 2 ** range.low);
    const title = field.name || "value";
    const label = `${name}, ${title}`;
    const words = Object.entries(field.values ?? {});
    let control, show;
    if (words.length) {
      control = el("select", { "aria-label": label }, words.map(([part, word]) => el("option", { value: part }, `${part}  ${word}`)));
      control.addEventListener("change", () => set(Number(control.value)));
      show = part => {
        if (!field.values[part] && !control.querySelector(`[value="${part}"]`)) control.append(el("option", { value: part }, `${part}`));
        control.value = part;
      };
    } else if (range.isBit) {
      control = el("button", { type: "button", role: "switch", class: "switch small-switch", "aria-label": label, onclick: () => set(1 - partOf(value, range)) });
      show = part => {
        attr(control, "aria-checked", part === 1);
        attr(control, "data-state", part ? "on" : "off");
      };
    } else {
      control = el("input", { type: "number", min: 0, max: range.size - 1, class: "small", "aria-label": label });
      control.addEventListener("change", () => (control.validity.valid && control.value !== "" ? set(Number(control.value)) : show(partOf(value, range), true)));
      show = (part, isReset) => {
        if (isReset || document.activeElement !== control) control.value = part;
      };
    }
    return { node: el("div", { "data-field": title }, el("dt", {}, el("code", {}, field.bits), ` ${title}`), el("dd", {}, control)), show: isReset => show(partOf(value, range), isReset) };
  });
  return {
    node: el("dl", { class: "fields" }, rows.map(row => row.node)),
    /** Shows a value; with `isReset` also in the control that one types in. */
    update(next, isReset = false) {
      value = next;
      rows.forEach(row => row.show(isReset));
    },
  };
}

/** The bits of a value, four and four, each group below the numbers of its bits. */
export function bitList(digits) {
  const groups = Array.from({ length: digits }, (_, i) => ({ bits: 4 * (digits - i) - 1, cell: el("dd", {}) }));
  const whole = el("dd", {});
  return {
    node: el("dl", { class: "bits" }, el("div", {}, el("dt", {}, "hexadecimal"), whole), groups.map(({ bits, cell }) => el("div", {}, el("dt", {}, `${bits}:${bits - 3}`), cell))),
    update(value) {
      text(whole, hex(value, digits));
      const string = (value < 0 ? value >>> 0 : value).toString(2).padStart(4 * digits, "0").slice(-4 * digits);
      groups.forEach(({ cell }, i) => text(cell, string.slice(4 * i, 4 * i + 4)));
    },
  };
}
