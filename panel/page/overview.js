// The bench: its figures, a drawing of lines, drives, motors and wires, the faults of its lines, and all traffic.

import { attr, card, el, svg, text } from "./dom.js";
import { ledColor } from "./faces.js";
import { lineCard } from "./line.js";
import { trafficCard } from "./traffic.js";
import { byName, failuresInWords, number } from "./format.js";

const MOST_DRAWN = 60; // drives
const BOX = { width: 168, height: 74, gap: 20 };

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
  let line = null, picture = new Map();

  const chooseLine = name => {
    line = lineCard(app, name);
    lineBox.replaceChildren(line.node);
    line.update({ changes: {}, whole: true });
  };
  choice.addEventListener("change", () => chooseLine(choice.value));

  const build = () => {
    const { buses = {}, wires: list = [] } = app.store.state;
    picture = draw(app, drawing, list);
    text(sketch.querySelector("h2"), Object.keys(app.store.state.drives).length > MOST_DRAWN ? "All drives" : "Wiring");
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
    if (picture.size && Math.abs(drawing.clientWidth - picture.width) > 20) {
      picture = draw(app, drawing, app.store.state.wires ?? []);
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

/** Many drives as a field of small tiles. The list has the same links for keys and screen readers. */
function matrix(app, changes) {
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
  return el("div", {}, field, el("p", { class: "matrix-key", "aria-hidden": "true" }, key, el("span", {}, el("i", { "data-state": "idle", class: "refused" }), "has refused or not answered a message")));
}

/** A name with at most so many characters. */
const short = (name, most) => (name.length > most ? `${name.slice(0, most - 1)}…` : name);

const stateOf = drive => (!drive.powered ? "off" : drive.fault ? "fault" : drive.moving ? "moving" : "idle");

/** Drives that share lines, as groups: `{buses, drives}`. */
function groupsOf(buses, drives) {
  const groups = [];
  for (const [name, bus] of Object.entries(buses)) {
    const met = groups.filter(group => bus.drives.some(drive => group.drives.has(drive)));
    const group = { buses: [name], drives: new Set(bus.drives) };
    for (const other of met) {
      group.buses.unshift(...other.buses);
      group.drives = new Set([...other.drives, ...group.drives]);
      groups.splice(groups.indexOf(other), 1);
    }
    groups.push(group);
  }
  const listed = new Set(groups.flatMap(group => [...group.drives]));
  for (const name of Object.keys(drives)) if (!listed.has(name)) groups.push({ buses: [], drives: new Set([name]) });
  const first = group => [...group.drives].sort(byName)[0] ?? "";
  return groups.sort((a, b) => byName(first(a), first(b)));
}

/** Draws the bench; returns what redraws each drive or motor. */
function draw(app, box, wires) {
  const { drives = {}, buses = {}, motors = {} } = app.store.state;
  const changes = new Map();
  changes.width = box.clientWidth;
  if (Object.keys(drives).length > MOST_DRAWN) {
    box.replaceChildren(matrix(app, changes));
    return changes;
  }
  const width = Math.max(260, box.clientWidth - 36);
  const step = BOX.width + BOX.gap;
  const perRow = Math.max(1, Math.floor((width + BOX.gap) / step));
  const items = [], under = [], over = [];
  const places = new Map();
  let x = 0, y = 0, rowHeight = 0;
  const rail = 22;

  for (const group of groupsOf(buses, drives)) {
    const names = [...group.drives].filter(name => drives[name]);
    const hasMotor = names.some(name => Object.values(motors).some(motor => motor.drive === name));
    const rows = Math.ceil(names.length / perRow);
    const columns = Math.min(perRow, names.length);
    const head = group.buses.length * rail + 14;
    const drawnHeight = head + rows * (BOX.height + (hasMotor ? 74 : 0) + 26);
    if (x > 0 && x + columns * step - BOX.gap > width) {
      x = 0;
      y += rowHeight + 14;
      rowHeight = 0;
    }
    group.buses.forEach((bus, i) => {
      const at = y + i * rail + 14;
      const isTcp = !buses[bus].line;
      under.push(svg("line", { x1: x, x2: x + columns * step - BOX.gap + (rows > 1 ? 12 : 0), y1: at, y2: at, class: isTcp ? "rail tcp" : "rail" }));
      over.push(svg("text", { x: x, y: at - 5, class: "rail-name" }, svg("title", {}, bus), short(bus, columns > 1 ? 40 : 14), svg("tspan", { class: "rail-line", dx: 6 }, buses[bus].line ?? "TCP")));
      names.forEach((name, n) => {
        if (!buses[bus].drives.includes(name)) return;
        if (n >= perRow) {
          // Drives of further rows hang on a line beside the boxes.
          const side = x + (n % perRow) * step + BOX.width + 7 + i * 5;
          const middle = y + head + Math.floor(n / perRow) * (BOX.height + (hasMotor ? 74 : 0) + 26) + 36;
          under.push(svg("path", { d: `M${side} ${at}V${middle}H${side - 10}`, class: isTcp ? "tap tcp" : "tap" }), svg("circle", { cx: side, cy: at, r: 3, class: "tap-dot" }));
          return;
        }
        const tap = x + (n % perRow) * step + BOX.width - 22 - i * 14;
        under.push(svg("line", { x1: tap, x2: tap, y1: at, y2: y + head, class: isTcp ? "tap tcp" : "tap" }), svg("circle", { cx: tap, cy: at, r: 3, class: "tap-dot" }));
      });
    });
    names.forEach((name, n) => {
      const left = x + (n % perRow) * step, top = y + head + Math.floor(n / perRow) * (BOX.height + (hasMotor ? 74 : 0) + 26);
      const lamp = svg("circle", { cx: BOX.width - 16, cy: 18, r: 4.5, class: "lamp" });
      const lights = svg("g", { class: "lights" });
      const figure = svg("text", { x: 14, y: 60, class: "box-figure" });
      const badge = svg("text", { x: BOX.width - 12, y: 60, class: "box-refused", "text-anchor": "end" });
      const link = svg("a", { href: `#/${encodeURIComponent(name)}`, transform: `translate(${left} ${top})`, class: "box" },
        svg("title", {}, `${name}, ${drives[name].kind}`), svg("rect", { width: BOX.width, height: BOX.height, rx: 7 }),
        svg("text", { x: 14, y: 23, class: "box-name" }, short(name, 14)), svg("text", { x: 14, y: 40, class: "box-kind" }, drives[name].kind), lamp, lights, figure, badge);
      items.push(link);
      const motor = Object.entries(motors).find(([, motor]) => motor.drive === name);
      let shaft = null;
      if (motor) {
        const cx = left + 34, cy = top + BOX.height + 40;
        shaft = svg("g", {}, svg("line", { x1: 0, x2: 0, y1: -6, y2: -17, class: "shaft-mark" }));
        under.push(svg("line", { x1: cx, x2: cx, y1: top + BOX.height, y2: cy - 20, class: "tap motor" }));
        items.push(svg("g", { transform: `translate(${cx} ${cy})`, class: "motor-sign" }, svg("circle", { r: 20 }), shaft, svg("text", { x: 30, y: -2, class: "box-kind" }, `motor ${short(motor[0], 12)}`)));
        places.set(motor[0], { x: cx - 8, y: cy + 18, taken: 0 });
        const rpm = svg("text", { x: cx + 30, y: cy + 14, class: "box-figure" });
        items.push(rpm);
        changes.set(`motor ${motor[0]}`, state => {
          const now = state.motors?.[motor[0]];
          if (!now) return;
          attr(shaft, "transform", `rotate(${(((now.revolutions % 1) + 1) % 1 * 360).toFixed(1)})`);
          text(rpm, `${number(now.rpm)} rpm`);
        });
      }
      places.set(name, { x: left + BOX.width - 34, y: top + BOX.height, taken: 0 });
      changes.set(name, state => {
        const drive = state.drives?.[name];
        if (!drive) return;
        attr(lamp, "data-state", stateOf(drive));
        text(figure, !drive.powered ? "no power" : drive.position === undefined ? "" : number(drive.position));
        if ((drive.lit ?? "") !== lights.dataset.lit) {
          lights.dataset.lit = drive.lit ?? "";
          lights.replaceChildren(...(drive.lit ?? "").split(" ").filter(Boolean).map((led, i) =>
            svg("circle", { cx: BOX.width - 16 - 13 * i, cy: 36, r: 3.5, class: `light ${ledColor(drive.kind, led)}` })));
        }
        const { refused, unanswered } = app.failures(name);
        text(badge, refused && unanswered ? `${number(refused + unanswered)} failed` : failuresInWords({ refused, unanswered }));
      });
    });
    x += columns * step + 16;
    rowHeight = Math.max(rowHeight, drawnHeight);
  }

  // Wires run below everything; those between the same two share a lane with their names.
  const paths = [];
  const endOf = end => {
    const name = [...places.keys()].filter(name => end === name || end.startsWith(`${name}.`)).sort((a, b) => b.length - a.length)[0];
    return name === undefined ? null : [name, end.slice(name.length + 1)];
  };
  const bundles = new Map();
  for (const { from, to } of wires) {
    const [a, b] = [endOf(from), endOf(to)];
    if (!a || !b) continue;
    const key = JSON.stringify([a[0], b[0]]);
    if (!bundles.has(key)) bundles.set(key, { from: a[0], to: b[0], outs: [], ins: [] });
    bundles.get(key).outs.push(a[1]);
    bundles.get(key).ins.push(b[1]);
  }
  let lane = y + rowHeight - 4;
  for (const { from, to, outs, ins } of bundles.values()) {
    const a = places.get(from), b = places.get(to);
    const start = a.x + 9 * a.taken++, end = b.x + 9 * b.taken++;
    const way = Math.sign(end - start) || 1, r = Math.min(8, Math.abs(end - start) / 2);
    paths.push(
      svg("path", { class: outs.length > 1 ? "wire several" : "wire", d: `M${start} ${a.y}V${lane - r}Q${start} ${lane} ${start + way * r} ${lane}H${end - way * r}Q${end} ${lane} ${end} ${lane - r}V${b.y}` }),
      svg("circle", { cx: end, cy: b.y, r: outs.length > 1 ? 3.4 : 2.6, class: "wire-end" }),
      svg("text", { x: Math.max((start + end) / 2, 90), y: lane - 6, "text-anchor": "middle", class: "wire-name" }, `${short(from, 16)} ${outs.join(", ")} → ${short(to, 16)} ${ins.join(", ")}`));
    lane += 24;
  }
  const height = Math.max(y + rowHeight + 6, paths.length ? lane - 8 : 0);
  box.replaceChildren(svg("svg", { width, height, viewBox: `-2 0 ${width + 2} ${height}`, role: "group", "aria-label": "Drawing of the bench" }, ...under, ...paths, ...items, ...over));
  return changes;
}
