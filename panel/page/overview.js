// The bench: its figures, a drawing of lines, drives, motors and wires, the faults of its lines, and all traffic.

import { attr, card, el, text } from "./dom.js";
import { lineCard } from "./line.js";
import { trafficCard } from "./traffic.js";
import { byName, failuresInWords, number } from "./format.js";
import { draw, stateOf } from "./wiring.js";

const MOST_DRAWN = 60; // drives

export function overview(app) {
  const traffic = trafficCard(app);
  const figures = el("dl", { class: "bench-figures" });
  const values = new Map(["drives", "moving", "without power", "with faults", "lines", "refused", "unanswered"].map(name => {
    const value = el("dd", {});
    figures.append(el("div", {}, el("dt", {}, name), value));
    return [name, value];
  }));
  const drawing = el("div", { class: "drawing" });
  const sketch = card("Wiring", { class: "sketch" }, null, drawing);
  const lineBox = el("div", { class: "line-cards" });
  const choice = el("select", { "aria-label": "Line" });
  const lines = el("div", { class: "lines" }, el("label", { class: "row" }, "Line ", choice), lineBox);
  const node = el("article", { class: "overview", "aria-label": "Bench" },
    el("header", { class: "drive-head" }, el("div", {}, el("h1", {}, "Bench"), figures)),
    sketch, el("div", { class: "columns" }, el("div", { class: "screens" }, traffic.node), el("div", { class: "controls" }, lines)));
  let line = null, picture = new Map(), width = 0;

  const chooseLine = name => {
    line = lineCard(app, name);
    lineBox.replaceChildren(line.node);
    line.update({ changes: {}, whole: true });
  };
  choice.addEventListener("change", () => chooseLine(choice.value));

  const isLarge = () => Object.keys(app.store.state.drives ?? {}).length > MOST_DRAWN;
  const show = () => {
    width = drawing.clientWidth;
    picture = isLarge() ? matrix(app, drawing) : draw(app, drawing);
  };
  const build = () => {
    const { buses = {} } = app.store.state;
    show();
    text(sketch.querySelector("h2"), isLarge() ? "All drives" : "Wiring");
    const names = Object.keys(buses);
    const kept = choice.value;
    choice.replaceChildren(...names.map(name => el("option", { value: name }, name)));
    lines.hidden = names.length === 0;
    if (names.length) {
      choice.value = names.includes(kept) ? kept : names.reduce((best, name) => (buses[name].drives.length > buses[best].drives.length ? name : best), names[0]);
      chooseLine(choice.value);
    }
  };
  const observer = new ResizeObserver(() => {
    if (picture.size && drawing.clientWidth !== width) {
      show();
      refresh();
    }
  });
  observer.observe(drawing);

  const refresh = () => picture.forEach(change => change(app.store.state));

  return {
    node,
    update(news) {
      const { state } = app.store;
      const { changes, whole } = news;
      const added = Object.values(changes.drives ?? {}).some(drive => drive === null || drive.kind !== undefined);
      if (whole || added || changes.wires) build();
      traffic.update(news);
      line?.update(news);
      if (!whole && !changes.drives && !changes.motors && !changes.buses) return;
      if (whole || added || changes.drives || changes.buses) {
        const drives = Object.entries(state.drives ?? {});
        text(values.get("drives"), number(drives.length));
        text(values.get("moving"), number(drives.filter(([, drive]) => drive.moving).length));
        text(values.get("without power"), number(drives.filter(([, drive]) => !drive.powered).length));
        text(values.get("with faults"), number(drives.filter(([, drive]) => drive.fault).length));
        text(values.get("lines"), number(Object.keys(state.buses ?? {}).length));
        for (const kind of ["refused", "unanswered"]) {
          const all = [...drives.map(([name]) => app.failures(name)), ...Object.values(state.buses ?? {})];
          const count = all.reduce((sum, one) => sum + (one[kind] ?? 0), 0);
          text(values.get(kind), number(count));
          attr(values.get(kind), "class", count ? "bad" : null);
        }
      }
      if (whole || added || changes.wires) refresh();
      else if (picture.size) {
        const names = new Set([...Object.keys(changes.drives ?? {}), ...Object.keys(changes.motors ?? {}).map(name => `motor ${name}`)]);
        for (const name of names) picture.get(name)?.(state);
      }
    },
    close: () => observer.disconnect(),
  };
}

/** Many drives as a field of small tiles; returns what redraws each. The list has the same links for keys and screen readers. */
function matrix(app, box) {
  const changes = new Map();
  const field = el("div", { class: "matrix", "aria-hidden": "true" });
  for (const name of Object.keys(app.store.state.drives).sort(byName)) {
    const tile = el("a", { href: `#/${encodeURIComponent(name)}`, tabindex: -1, title: name });
    field.append(tile);
    changes.set(name, state => {
      const drive = state.drives?.[name];
      if (drive) attr(tile, "data-state", stateOf(drive));
      const words = failuresInWords(app.failures(name));
      tile.classList.toggle("refused", words !== "");
      attr(tile, "title", words ? `${name}: ${words}` : name);
    });
  }
  const key = ["idle", "moving", "fault", "off"].map(state => el("span", {}, el("i", { "data-state": state }), { idle: "not moving", moving: "moving", fault: "has a fault", off: "no power" }[state]));
  box.replaceChildren(field, el("p", { class: "matrix-key", "aria-hidden": "true" }, key, el("span", {}, el("i", { "data-state": "idle", class: "refused" }), "has refused or not answered a message")));
  return changes;
}
