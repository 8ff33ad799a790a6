// Registers by name: value, meaning, section of the manual; those that changed are lit for a moment.

import { attr, button, card, el, text } from "./dom.js";
import { bitList, fieldList, meaning } from "./fields.js";
import { clock, hex, number } from "./format.js";

const LIT = 900; // milliseconds
const ON_THE_BUS = ["holding", "input", "coil", "discrete"]; // spaces with addresses; others are reached by name only
const BITS = { bit: 1, u8: 2, u16: 4, i16: 4, u32: 8, i32: 8 };

/** A typed value: decimal, 0x, 0b, with commas between the words of a list; null if it is none. Elsewhere commas between
 * thousands are left out: 10,000 is ten thousand. */
export function parse(typed, isList) {
  const thousands = /^\s*[-−]?\d{1,3}(,\d{3})+\s*$/;
  if (!isList && thousands.test(typed)) typed = typed.replaceAll(",", "");
  const one = word => {
    const clean = word.replace(/[\s _]/g, "").replace("−", "-");
    return /^-?(\d+|0x[0-9a-f]+|0b[01]+)$/i.test(clean) ? (clean.startsWith("-") ? -Number(clean.slice(1)) : Number(clean)) : NaN;
  };
  const values = typed.split(/[,;]/).map(one);
  if (values.some(Number.isNaN)) return null;
  return values.length === 1 ? values[0] : values;
}

export function registersCard(app, drive, kind) {
  let asHex = false, words = "", only = "all";
  const rows = new Map();
  const lit = new Map();

  const search = el("input", { type: "search", placeholder: "Filter registers", "aria-label": "Filter registers by name, address or meaning", class: "filter", autocomplete: "off", spellcheck: "false" });
  const chips = [["all", "All"], ["changed", "Changed"], ["refused", "Refused"]].map(([key, title]) =>
    button(title, { "data-filter": key, "aria-pressed": key === only }, () => {
      only = key;
      chips.forEach(chip => attr(chip, "aria-pressed", chip.dataset.filter === only));
      sift();
    }));
  const hexButton = button("Hex", { class: "toggle", "aria-pressed": false, title: "Show values in hexadecimal" }, () => {
    asHex = !asHex;
    attr(hexButton, "aria-pressed", asHex);
    rows.forEach(row => row.draw(true));
  });
  const none = el("p", { class: "empty", hidden: true }, "No register passes the filter.");
  const list = el("div", { class: "registers" });
  const node = card("Registers", { id: "registers" },
    el("div", { class: "tools" }, el("div", { class: "segments", role: "group", "aria-label": "Which registers" }, chips), search, hexButton), list, none);

  for (const register of kind.registers) {
    const row = makeRow(app, drive, register, () => asHex);
    rows.set(register.name, row);
    list.append(row.node);
  }
  // All rows have the same columns, so that values stand below each other.
  list.style.setProperty("--section", `${Math.min(16, Math.max(...kind.registers.map(register => sectionOf(register).length)))}ch`);
  // One stop of the Tab key for the whole table; the arrow keys go from row to row.
  let current = null;
  const stopAt = row => {
    if (current === row) return;
    if (current) current.input.tabIndex = -1;
    current = row;
    if (row) row.input.tabIndex = 0;
  };
  stopAt(rows.values().next().value);
  list.addEventListener("focusin", event => stopAt(rows.get(event.target.closest(".register").dataset.register)));
  const sift = () => {
    let shown = 0;
    for (const row of rows.values()) {
      const fits = (words === "" || row.words.includes(words)) && (only === "all" || (only === "changed" ? row.changed : row.refused));
      row.node.hidden = !fits;
      shown += fits;
    }
    if (current?.node.hidden) stopAt([...rows.values()].find(row => !row.node.hidden) ?? current);
    none.hidden = shown > 0;
    text(none, only === "refused" && words === "" ? "No message about a register was refused." : only === "changed" && words === ""
      ? "No register has changed since this page was opened." : "No register passes the filter.");
  };
  search.addEventListener("input", () => {
    words = search.value.trim().toLowerCase();
    sift();
  });
  const sweep = setInterval(() => {
    const now = performance.now();
    for (const [row, since] of lit) {
      if (now - since > LIT) {
        row.node.classList.remove("lit");
        lit.delete(row);
      }
    }
  }, 300);

  return {
    node,
    /** Takes the sentence of a refused message to the registers that it is about, until one writes them. */
    take(frame) {
      for (const name of frame.registers ?? []) {
        if (frame.verdict === "refused") rows.get(name)?.refuse(frame);
        else rows.get(name)?.forgive();
      }
      if (only === "refused" && frame.registers) sift();
    },
    update({ changes, whole }) {
      const now = app.store.state.drive;
      const isAll = whole || changes.drive?.powered !== undefined;
      for (const [name, row] of isAll ? rows : Object.keys(changes.drive?.registers ?? {}).map(name => [name, rows.get(name)])) {
        if (changes.drive?.powered) row.excuse();
        // Without power nobody can read a value. A board that cannot be reached has none either.
        const isNew = row?.set(now?.powered ? now.registers?.[name] : undefined);
        if (isNew && !whole) {
          row.changed = true;
          if (!lit.has(row)) row.node.classList.add("lit");
          lit.set(row, performance.now());
          if (only === "changed" && row.node.hidden) sift();
        }
      }
    },
    close: () => clearInterval(sweep),
  };
}

function makeRow(app, drive, register, asHex) {
  const { name, address, space, type, access, doc, section } = register;
  const digits = BITS[type] ?? 4;
  const isList = !(type in BITS);
  let value, edited = false;
  const input = el("input", { "data-edit": name, "aria-label": name, inputmode: "text", autocomplete: "off", spellcheck: "false", tabindex: -1, title: "Enter writes, Escape gives up, Alt and down shows the fields", disabled: access === "-", placeholder: "–" });
  const hasFields = register.fields?.length > 0;
  const means = el("p", { class: "meaning" });
  const parts = [hasFields ? fieldList(name, register.fields, next => write(next)) : null, digits > 1 ? bitList(digits) : null].filter(Boolean);
  const error = el("p", { class: "error", role: "alert", hidden: true });
  const refused = el("span", {});
  const refusal = el("p", { class: "refusal", hidden: true }, refused, button("×", { class: "ghost", "aria-label": `Close the note on ${name}`, tabindex: -1 }, () => {
    row.forgive();
    input.focus();
  }));
  const more = el("div", { class: "register-more", id: `more-${name}`, hidden: true });
  const title = button([el("span", { class: "name" }, breakable(name))], { class: "register-name", "aria-expanded": false, tabindex: -1, "aria-controls": `more-${name}` }, () => {
    const open = more.hidden;
    if (open && !more.childElementCount) explain();
    more.hidden = !open;
    attr(title, "aria-expanded", open);
    if (open) row.draw();
  });
  const node = el("div", { class: "register", "data-register": name },
    el("span", { class: "address" }, ON_THE_BUS.includes(space) ? hex(address) : ""),
    title, input,
    el("span", { class: "access", title: { "R/W": "read and write", R: "read only", W: "write only", "-": "not accessible" }[access] }, access === "-" ? "–" : access),
    el("p", { class: "doc" }, doc),
    el("span", { class: "section", title: `Section of the manual: ${section}` }, sectionOf(register)),
    hasFields ? means : null, error, refusal, more);

  const shown = () => {
    const one = part => (asHex() ? hex(part, digits) : number(part));
    return value === undefined ? "" : Array.isArray(value) ? value.map(one).join(", ") : one(value);
  };
  const row = {
    node, input, changed: false, refused: false,
    words: `${name} ${doc} ${register.fields?.map(field => field.name).join(" ") ?? ""} ${hex(address ?? 0)} ${hex(address ?? 0, 0)} ${address ?? ""} ${section}`.toLowerCase(),
    draw() {
      if (!edited && input.value !== shown()) {
        // What is selected whole stays so: the next digit begins a new number.
        const isAll = document.activeElement === input && input.selectionStart === 0 && input.selectionEnd === input.value.length;
        input.value = shown();
        if (isAll) input.select();
      }
      if (hasFields) text(means, typeof value === "number" ? meaning(register.fields, value) : "");
      parts.forEach(part => (part.node.hidden = typeof value !== "number"));
      if (typeof value !== "number") return;
      if (!more.hidden) parts.forEach(part => part.update(value));
    },
    /** Takes a value; true if it is another one than before. */
    set(next) {
      if (String(next) === String(value)) return false;
      const both = value !== undefined && next !== undefined;
      value = next;
      attr(node, "data-value", Array.isArray(next) ? next.join(",") : next);
      row.draw();
      return both;
    },
    refuse(frame) {
      row.refused = true;
      refusal.hidden = false;
      refused.replaceChildren(el("b", {}, `Refused at ${clock(frame.at)} s: `), frame.text, frame.reason ? `: ${frame.reason}` : "");
      node.classList.add("has-refusal");
    },
    /** Takes back the sentence of a refused value: the power is back. */
    excuse: () => fail(null),
    forgive() {
      row.refused = false;
      refusal.hidden = true;
      node.classList.remove("has-refusal");
    },
  };
  const fail = sentence => {
    error.hidden = !sentence;
    attr(node, "data-error", sentence);
    attr(error, "data-error", sentence);
    attr(input, "aria-invalid", sentence ? true : null);
    text(error, sentence ?? "");
  };
  input.addEventListener("focus", () => input.select());
  input.addEventListener("input", () => {
    edited = true;
    node.classList.add("edited");
  });
  const revert = () => {
    edited = false;
    node.classList.remove("edited");
    input.value = shown();
    if (document.activeElement === input) input.select();
  };
  const commit = async () => {
    if (!edited) return;
    const typed = parse(input.value, isList);
    if (typed === null) return fail(`'${input.value}' is not a number; write it as 10, -10 or 0x0A${isList ? ", with commas between the words" : ""}`);
    if ([typed].flat().some(number => !Number.isSafeInteger(number))) return fail(`'${input.value}' is too large`);
    if (Array.isArray(typed) && !isList) return fail(`${name} takes one number, not ${typed.length}`);
    input.select();
    await write(typed);
  };
  const write = async typed => {
    const before = input.value;
    const answer = await app.backend.call("PUT", `drives/${encodeURIComponent(drive)}/registers/${encodeURIComponent(name)}`, { value: typed });
    if (!answer.ok) {
      // The fields have not taken the value: they show again what the drive has.
      if (typeof value === "number") parts.forEach(part => part.update(value, true));
      return fail(answer.body?.detail ?? "The bench refused the value.");
    }
    // The next update has what the drive made of the value.
    fail(null);
    row.forgive();
    if (input.value === before) revert(); // otherwise the next value is typed already
  };
  input.addEventListener("keydown", event => {
    if (event.key === "Enter") commit();
    if (event.key === "Escape") {
      fail(null);
      revert();
    }
    if (event.altKey && event.key === "ArrowDown") return title.click();
    if (event.key === "ArrowDown" || event.key === "ArrowUp") {
      event.preventDefault();
      let other = node;
      do other = event.key === "ArrowDown" ? other.nextElementSibling : other.previousElementSibling; while (other && (other.hidden || other.querySelector("input").disabled));
      other?.querySelector("input").focus();
    }
  });
  // Leaving the field does not write: a half typed value must not reach a drive. It stays, marked, until Enter or Escape.
  input.addEventListener("blur", () => {
    if (edited && input.value === shown()) revert();
  });

  const explain = () => {
    const range = register.codes ? register.codes.join(", ") : register.least === null ? null : `${number(register.least)} to ${number(register.greatest)}`;
    const facts = [
      ["Type", type], ["Space", space], ["Range", range],
      ["Acts within", register.acts_within && `${number(register.acts_within[0])} to ${number(register.acts_within[1])}`],
      ["Default", Array.isArray(register.default) ? register.default.join(", ") : register.default === null ? null : `${number(register.default)} = ${hex(register.default, digits)}`],
      ["Saved", register.saved_bits ? "in the non-volatile memory" : "no"],
      ["Addresses", register.addresses > 1 ? `${hex(address)} to ${hex(address + register.addresses - 1)}` : null],
      ["Not modelled", register.not_modelled],
    ].filter(([, fact]) => fact !== null && fact !== undefined && fact !== "");
    more.append(el("p", { class: "doc-whole" }, doc), el("dl", { class: "facts" }, facts.map(([term, fact]) => el("div", {}, el("dt", {}, term), el("dd", {}, fact)))), ...parts.map(part => part.node));
  };
  return row;
}

const sectionOf = ({ section }) => (/^[\d.]+$/.test(section) ? `§ ${section}` : section);

/** A long name that may break before its words. */
const breakable = name => name.split(/(?<=[a-z])(?=[A-Z])|(?<=_)/).flatMap((part, i) => (i ? [el("wbr"), part] : [part]));
