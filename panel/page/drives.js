// The list of drives with its search. Only the rows in sight exist, so that 1,000 drives cost no more than 20.

import { attr, el, text } from "./dom.js";
import { byName } from "./format.js";

const ROW = 44; // height of a row in CSS pixels; panel.css has the same

export function driveList(app, node) {
  const search = el("input", {
    type: "search", placeholder: "Search drives", "aria-label": "Search drives by name or kind", autocomplete: "off", spellcheck: "false",
  });
  const hint = el("kbd", { "aria-hidden": "true" }, "/");
  const count = el("p", { class: "count", role: "status" });
  const bench = el("a", { href: "#/", class: "bench-link" }, "Bench");
  const rows = el("ul", { class: "rows" });
  const scroller = el("div", { class: "scroller", tabindex: "-1" }, rows);
  node.append(el("div", { class: "search" }, search, hint), bench, count, scroller);

  let names = [], chosen = null, first = -1, last = -1;
  const made = new Map();

  const select = () => {
    const words = search.value.trim().toLowerCase().split(/\s+/).filter(Boolean);
    const drives = app.store.state.drives ?? {};
    names = Object.keys(drives)
      .filter(name => words.every(word => name.toLowerCase().includes(word) || drives[name].kind.includes(word)))
      .sort(byName);
    const all = Object.keys(drives).length;
    text(count, words.length ? `${names.length} of ${all} drives` : `${all} ${all === 1 ? "drive" : "drives"}`);
    rows.style.height = `${names.length * ROW}px`;
    rows.replaceChildren();
    made.clear();
    first = last = -1;
    place();
  };

  const place = () => {
    const from = Math.max(0, Math.floor(scroller.scrollTop / ROW) - 4);
    const to = Math.min(names.length, Math.ceil((scroller.scrollTop + scroller.clientHeight) / ROW) + 4);
    if (from === first && to === last) return;
    [first, last] = [from, to];
    for (const [name, row] of made) {
      if (row.index < from || row.index >= to) {
        row.node.remove();
        made.delete(name);
      }
    }
    for (let index = from; index < to; index++) {
      if (!made.has(names[index])) {
        const row = makeRow(names[index], index, names.length);
        made.set(names[index], row);
        rows.append(row.node);
      }
    }
    made.forEach((row, name) => draw(row, name));
  };

  const draw = (row, name) => {
    const drive = app.store.state.drives?.[name];
    if (!drive) return;
    text(row.kind, drive.powered ? drive.kind : `no power · ${drive.kind}`);
    const state = !drive.powered ? "off" : drive.fault ? "fault" : drive.moving ? "moving" : "idle";
    attr(row.lamp, "data-state", state);
    attr(row.lamp, "title", { off: "no power", fault: "has a fault", moving: "moving", idle: "powered, not moving" }[state]);
    for (const [kind, count] of Object.entries(app.failures(name))) {
      row[kind].hidden = count === 0;
      if (count) text(row[kind], `${count > 999 ? "999+" : count} ${kind}`);
      attr(row[kind], "data-value", count);
    }
    attr(row.link, "aria-current", name === chosen ? "page" : null);
  };

  search.addEventListener("input", () => {
    scroller.scrollTop = 0;
    select();
  });
  search.addEventListener("keydown", event => {
    if (event.key === "Enter" && names.length) location.hash = `#/${encodeURIComponent(names[0])}`;
    if (event.key === "Escape") {
      search.value = "";
      select();
    }
    if (event.key === "ArrowDown" && names.length) {
      event.preventDefault();
      go(0);
    }
  });
  rows.addEventListener("keydown", event => {
    const step = { ArrowDown: 1, ArrowUp: -1, PageDown: 10, PageUp: -10, Home: -1e9, End: 1e9 }[event.key];
    if (!step) return;
    event.preventDefault();
    const index = names.indexOf(event.target.closest("li").dataset.listed) + step;
    if (index < 0 && step === -1) search.focus();
    else go(Math.max(0, Math.min(names.length - 1, index)));
  });
  const go = index => {
    const top = index * ROW;
    if (top < scroller.scrollTop) scroller.scrollTop = top;
    if (top + ROW > scroller.scrollTop + scroller.clientHeight) scroller.scrollTop = top + ROW - scroller.clientHeight;
    place();
    made.get(names[index])?.link.focus();
  };
  scroller.addEventListener("scroll", place, { passive: true });
  new ResizeObserver(place).observe(scroller);

  return {
    focus: () => search.focus(),
    choose(name) {
      chosen = name;
      attr(bench, "aria-current", name === null ? "page" : null);
      made.forEach(draw);
    },
    update({ changes, whole }) {
      const changed = changes.drives;
      if (whole || Object.values(changed ?? {}).some(drive => drive === null || drive.kind !== undefined)) select();
      else if (changed) made.forEach((row, name) => changed[name] && draw(row, name));
    },
  };
}

function makeRow(name, index, all) {
  const lamp = el("span", { class: "lamp", "aria-hidden": "true" });
  const kind = el("span", { class: "kind" });
  const refused = el("span", { class: "badge", "data-failures": "refused", hidden: true });
  const unanswered = el("span", { class: "badge warn", "data-failures": "unanswered", hidden: true });
  const link = el("a", { href: `#/${encodeURIComponent(name)}` }, lamp, el("span", { class: "name" }, name), " ", kind, " ", el("span", { class: "badges" }, refused, " ", unanswered));
  const node = el("li", { "data-listed": name, "aria-setsize": all, "aria-posinset": index + 1 }, link);
  node.style.transform = `translateY(${index * ROW}px)`;
  return { node, link, lamp, kind, refused, unanswered, index };
}
