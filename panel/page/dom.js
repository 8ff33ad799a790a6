// Helpers that make elements, and change only what differs.

const SVG = "http://www.w3.org/2000/svg";

function fill(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes ?? {})) {
    if (value === undefined || value === null || (value === false && !name.startsWith("aria-"))) continue;
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else node.setAttribute(name, value === true && !name.startsWith("aria-") ? "" : value);
  }
  node.append(...children.flat().filter(child => child !== null && child !== undefined));
  return node;
}

/** An HTML element. Attributes that begin with `on` are listeners; null children are left out. */
export const el = (tag, attributes, ...children) => fill(document.createElement(tag), attributes, children);

/** An SVG element. */
export const svg = (tag, attributes, ...children) => fill(document.createElementNS(SVG, tag), attributes, children);

/** Sets the text of a node that holds nothing but text. */
export function text(node, value) {
  const string = String(value);
  if (node.firstChild === null) node.append(string);
  else if (node.firstChild.data !== string) node.firstChild.data = string;
}

/** Sets an attribute; null and undefined remove it. */
export function attr(node, name, value) {
  if (value === null || value === undefined) node.removeAttribute(name);
  else if (node.getAttribute(name) !== String(value)) node.setAttribute(name, value);
}

/** A button with the text or the nodes of `content`. */
export const button = (content, attributes, action) =>
  el("button", { type: "button", ...attributes, onclick: action }, content);

/** The number in a field from the `least` to the greatest allowed one, or null: then a sentence is shown at the field. */
export function numberOf(input, what, least, greatest, isWhole = true) {
  const value = Number(input.value);
  const fits = input.value !== "" && input.validity.badInput === false && value >= least && value <= greatest && (!isWhole || Number.isInteger(value));
  let note = input.parentNode.querySelector(".field-note");
  if (fits) note?.remove();
  else {
    if (!note) input.after(note = el("span", { class: "field-note", role: "alert" }));
    text(note, `${what} takes a ${isWhole ? "whole " : ""}number from ${least} to ${greatest}.`);
  }
  attr(input, "aria-invalid", fits ? null : true);
  return fits ? value : null;
}

/** A section with a heading and further controls in its head. */
export function card(title, attributes, head, ...body) {
  const heading = el("h2", {}, title);
  return el("section", { ...attributes, class: `card ${attributes?.class ?? ""}`, "aria-label": title },
    el("div", { class: "card-head" }, heading, head), ...body);
}

/** Greys the controls within `node` if the bench cannot do it, and shows the reason. */
export function greyed(node, reason) {
  if ((node.dataset.cannot ?? "") === (reason ?? "")) return;
  if (reason) node.dataset.cannot = reason; else delete node.dataset.cannot;
  for (const control of node.querySelectorAll("button, input, select")) control.disabled = Boolean(reason);
  let note = node.querySelector(":scope > .reason");
  if (!reason) note?.remove();
  else {
    if (!note) node.append(note = el("p", { class: "reason" }));
    text(note, reason);
  }
}
