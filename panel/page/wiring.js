// The drawing of a bench: rows of drives with their lines above and their motors below, and the wires in lanes below each row.

import { attr, svg, text } from "./dom.js";
import { ledColor } from "./faces.js";
import { byName, failuresInWords, number } from "./format.js";

const BOX = { least: 172, most: 320, height: 74, gap: 24 };
const MOTOR = { x: 27, y: 33, radius: 18, height: 52 }; // its centre from the left and the bottom of the box, and its room
const RAIL = 22; // from one line of a drive to the next
const LANE = 24; // from one lane of wires to the next
const COLUMN = 10; // from one wire at the left to the next, at most
const MARGIN = 60; // most that the wires at the left take
const LETTER = 6.4; // width of a character of a wire's name

export const stateOf = drive => (!drive.powered ? "off" : drive.fault ? "fault" : drive.moving ? "moving" : "idle");

/** A name with at most so many characters. */
const short = (name, most) => (name.length > most ? `${name.slice(0, Math.max(1, Math.floor(most)) - 1)}…` : name);

/** Drives that share lines, as groups: `{buses, drives}`. */
function groupsOf(buses, drives) {
  const groups = [];
  for (const [name, bus] of Object.entries(buses)) {
    const known = bus.drives.filter(drive => drives[drive]);
    const met = groups.filter(group => known.some(drive => group.drives.has(drive)));
    const group = { buses: [name], drives: new Set(known) };
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

/** The same groups, each followed by those that wires lead to or come from. */
function nextToWired(groups, wires, motors) {
  const groupOf = end => {
    const [name] = end.split(".");
    return groups.find(group => group.drives.has(motors[name]?.drive ?? name));
  };
  const pairs = wires.map(({ from, to }) => [groupOf(from), groupOf(to)]);
  const taken = new Set();
  const take = group => {
    if (!group || taken.has(group)) return;
    taken.add(group);
    for (const pair of pairs) if (pair.includes(group)) pair.forEach(take);
  };
  groups.forEach(take);
  return [...taken];
}

/** Rows of `{group, name}`. A group that fits into one row is not divided; a larger one begins a row. */
function rowsOf(groups, perRow) {
  const rows = [];
  for (const group of groups) {
    let room = perRow - (rows.at(-1)?.length ?? perRow);
    if (group.drives.size > room) room = 0;
    for (const name of group.drives) {
      if (room === 0) {
        rows.push([]);
        room = perRow;
      }
      rows.at(-1).push({ group, name });
      room--;
    }
  }
  return rows;
}

/** Where wires begin and end: below drives, at the right, and below motors, at the left. */
function placesOf(rows, motors) {
  const places = new Map();
  rows.forEach((cells, row) => cells.forEach(({ name }, column) => {
    places.set(name, { row, column, order: 2 * column + 1, ends: [] });
    const motor = Object.keys(motors).find(motor => motors[motor].drive === name);
    if (motor) places.set(motor, { row, column, order: 2 * column, ends: [], turnedBy: name });
  }));
  return places;
}

/** The first of the tracks that is free between two points, which are then taken. */
function trackOf(tracks, from, to) {
  const free = tracks.findIndex(taken => taken.every(([start, end]) => to < start || from > end));
  const track = free < 0 ? tracks.push([]) - 1 : free;
  tracks[track].push([from, to]);
  return track;
}

/** Wires of a sort between the same two places, as one. Those between rows have a column of `columns`, left of all. */
function bundlesOf(wires, places, columns) {
  const bundles = new Map();
  for (const wire of wires) {
    const [[from, ...out], [to, ...into]] = [wire.from.split("."), wire.to.split(".")];
    const [a, b] = [places.get(from), places.get(to)];
    if (!a || !b) continue;
    const sort = a.turnedBy && !/^(a|b|index)$/.test(out) ? out : ""; // hall or switch; an encoder has three outputs
    const key = `${from} ${to} ${sort}`;
    if (!bundles.has(key)) {
      const column = a.row === b.row ? null : trackOf(columns, Math.min(a.row, b.row), Math.max(a.row, b.row));
      const ends = [[a, b], [b, a]].map(([place, other]) => ({ place, towards: column === null ? other.order : -1, bundle: bundles.size }));
      ends.forEach(end => end.place.ends.push(end));
      bundles.set(key, { from, to, outs: new Set(), ins: new Set(), ends, column, count: 0 });
    }
    const bundle = bundles.get(key);
    bundle.outs.add(out.join("."));
    bundle.ins.add(into.join("."));
    bundle.count++;
  }
  // At each place, those that go left are left, and those that go farthest are in the middle, so that lanes lie within lanes.
  const isRight = end => end.towards > end.place.order;
  const within = (one, two) => two.towards - one.towards || (isRight(one) ? one.bundle - two.bundle : two.bundle - one.bundle);
  for (const { ends } of places.values()) ends.sort((one, two) => isRight(one) - isRight(two) || within(one, two));
  return [...bundles.values()];
}

/** The words for a bundle, from the longest to the shortest; the drive and its own motor need no names. */
function wordsOf({ from, to, outs, ins }, places) {
  const [out, into] = [outs, ins].map(pins => [...pins].join(", "));
  const words = [`${from} ${out} → ${to} ${into}`, `${out} → ${into}`, `→ ${into}`];
  return places.get(from).turnedBy === to ? words.slice(1) : words;
}

/** The widest part of a lane that no wire of a deeper lane crosses. */
function gapOf({ from, to, lane }, parts) {
  const crossing = parts.filter(part => part.lane > lane).flatMap(part => part.ends).filter(x => x > from && x < to);
  const at = [from, ...crossing.sort((a, b) => a - b), to];
  return at.slice(1).map((end, i) => [at[i], end]).reduce((best, gap) => (gap[1] - gap[0] > best[1] - best[0] ? gap : best));
}

/** A path along points, with round corners. */
function rounded(points) {
  const towards = ([x, y], [toX, toY]) => {
    const far = Math.hypot(toX - x, toY - y) || 1, part = Math.min(8, far / 2) / far;
    return `${x + (toX - x) * part} ${y + (toY - y) * part}`;
  };
  const corners = points.slice(1, -1).map((point, i) => `L${towards(point, points[i])}Q${point.join(" ")} ${towards(point, points[i + 2])}`);
  return `M${points[0].join(" ")}${corners.join("")}L${points.at(-1).join(" ")}`;
}

/** Draws the bench; returns what redraws each drive or motor. */
export function draw(app, box) {
  const { drives = {}, buses = {}, motors = {}, wires = [] } = app.store.state;
  const changes = new Map();
  const width = Math.max(BOX.least, box.clientWidth - 36);
  const fit = Math.max(1, Math.floor((width + BOX.gap) / (BOX.least + BOX.gap)));
  const perRow = Math.min(fit, Object.keys(drives).length);
  const rows = rowsOf(nextToWired(groupsOf(buses, drives), wires, motors), perRow);
  const places = placesOf(rows, motors);
  const columns = [];
  const bundles = bundlesOf(wires, places, columns);

  // From left to right: columns of wires, lines that go on in the next row, and the boxes.
  const goOn = rows.filter((cells, row) => rows[row + 1]?.[0].group === cells.at(-1).group).map(cells => cells.at(-1).group);
  const column = Math.min(COLUMN, MARGIN / columns.length);
  const left = (columns.length && columns.length * column + 4) + Math.max(0, ...goOn.map(group => 5 + 5 * group.buses.length));
  const size = Math.min(BOX.most, (width - left + BOX.gap) / perRow - BOX.gap);
  for (const place of places.values()) {
    const [middle, room] = place.turnedBy ? [MOTOR.x, 24] : [size - 17, 22];
    place.ends.forEach((end, i) => { end.x = left + place.column * (size + BOX.gap) + middle + room * ((i + 0.5) / place.ends.length - 0.5); });
  }

  // Lanes: the shortest above.
  const lanes = rows.map(() => []);
  const parts = bundles.flatMap(bundle => {
    const part = (row, ...at) => ({ bundle, row, from: Math.min(...at), to: Math.max(...at), ends: at.slice(-2) });
    const [a, b] = bundle.ends;
    bundle.margin = (bundle.column + 0.5) * column;
    bundle.parts = bundle.column === null ? [part(a.place.row, a.x, b.x)] : [a, b].map(end => part(end.place.row, bundle.margin, end.x));
    return bundle.parts;
  }).sort((one, two) => one.to - one.from - (two.to - two.from));
  for (const part of parts) part.lane = trackOf(lanes[part.row], part.from - 4, part.to + 4);

  const under = [], items = [], over = [];
  const sides = new Map();
  let y = 0;
  rows.forEach((cells, row) => {
    const most = Math.max(0, ...cells.map(({ group }) => group.buses.length));
    const top = y + most * RAIL + 14, bottom = top + BOX.height;
    const hasMotor = cells.some(({ name }) => Object.values(motors).some(motor => motor.drive === name));
    for (const group of new Set(cells.map(cell => cell.group))) {
      const first = cells.findIndex(cell => cell.group === group), count = cells.filter(cell => cell.group === group).length;
      const x = left + first * (size + BOX.gap), end = x + count * (size + BOX.gap) - BOX.gap;
      group.buses.forEach((bus, i) => {
        const at = top - (group.buses.length - i) * RAIL, kind = buses[bus].line ? "" : " tcp";
        const side = left - 5 - 5 * i;
        under.push(svg("line", { x1: goOn.includes(group) ? side : x, x2: end, y1: at, y2: at, class: `rail${kind}` }));
        if (sides.has(bus)) under.push(svg("line", { x1: side, x2: side, y1: sides.get(bus), y2: at, class: `rail${kind}` }));
        sides.set(bus, at);
        const line = buses[bus].line ?? "TCP";
        const room = (end - x - (i ? 30 + 14 * i : 0)) / 6.9 - line.length;
        over.push(svg("text", { x, y: at - 5, class: "rail-name" }, svg("title", {}, bus), short(bus, room), svg("tspan", { class: "rail-line", dx: 6 }, line)));
        cells.forEach(({ name }, n) => {
          if (!buses[bus].drives.includes(name)) return;
          const tap = left + n * (size + BOX.gap) + size - 22 - i * 14;
          under.push(svg("line", { x1: tap, x2: tap, y1: at, y2: top, class: `tap${kind}` }), svg("circle", { cx: tap, cy: at, r: 3, class: "tap-dot" }));
        });
      });
    }
    cells.forEach(({ name }, n) => {
      const x = left + n * (size + BOX.gap);
      places.get(name).bottom = bottom;
      items.push(driveBox(app, name, size, x, top, changes));
      const motor = [...places.keys()].find(motor => places.get(motor).turnedBy === name);
      if (!motor) return;
      places.get(motor).bottom = bottom + MOTOR.y + MOTOR.radius;
      items.push(motorSign(motor, size, x, bottom, changes));
    });
    y = bottom + (hasMotor ? MOTOR.height : 0);
    lanes[row].top = y + 16;
    y += lanes[row].length * LANE + 18;
  });

  const paths = bundles.map(bundle => {
    const { ends: [a, b], margin, count } = bundle;
    const at = bundle.parts.map(part => lanes[part.row].top + part.lane * LANE);
    const middle = bundle.column === null ? [] : [[margin, at[0]], [margin, at[1]]];
    const points = [[a.x, a.place.bottom], [a.x, at[0]], ...middle, [b.x, at.at(-1)], [b.x, b.place.bottom]];
    const longest = bundle.parts.reduce((one, two) => (two.to - two.from > one.to - one.from ? two : one));
    const [from, to] = gapOf({ ...longest, from: Math.max(longest.from, left - BOX.gap / 2) }, parts.filter(part => part.row === longest.row));
    const room = (to - from - 18) / LETTER, x = (from + to) / 2, y = lanes[longest.row].top + longest.lane * LANE;
    const words = wordsOf(bundle, places);
    if (room > 3) {
      const shown = words.find(text => text.length <= room) ?? short(words.at(-1), room), long = shown.length * LETTER + 8;
      over.push(svg("g", { class: "wire-name" }, svg("title", {}, words[0]), svg("rect", { x: x - long / 2, y: y - 8, width: long, height: 16 }), svg("text", { x, y: y + 4 }, shown)));
    }
    over.push(svg("circle", { cx: b.x, cy: b.place.bottom, r: count > 1 ? 3.4 : 2.6, class: "wire-end" }));
    return svg("path", { class: count > 1 ? "wire several" : "wire", d: rounded(points) });
  });
  const height = y - 12;
  box.replaceChildren(svg("svg", { width, height, viewBox: `-2 0 ${width + 4} ${height}`, role: "group", "aria-label": "Drawing of the bench" }, ...under, ...paths, ...items, ...over));
  return changes;
}

/** A drive: name, kind, lights, position or count, and messages without success. */
function driveBox(app, name, size, x, y, changes) {
  const { kind } = app.store.state.drives[name];
  const lamp = svg("circle", { cx: size - 16, cy: 18, r: 4.5, class: "lamp" });
  const lights = svg("g", { class: "lights" });
  const figure = svg("text", { x: 14, y: 60, class: "box-figure" });
  const badge = svg("text", { x: size - 12, y: 60, class: "box-refused", "text-anchor": "end" });
  changes.set(name, state => {
    const drive = state.drives?.[name];
    if (!drive) return;
    attr(lamp, "data-state", stateOf(drive));
    const count = drive.position ?? drive.count;
    text(figure, !drive.powered ? "no power" : count === undefined ? "" : number(count));
    if ((drive.lit ?? "") !== lights.dataset.lit) {
      lights.dataset.lit = drive.lit ?? "";
      lights.replaceChildren(...(drive.lit ?? "").split(" ").filter(Boolean).map((led, i) =>
        svg("circle", { cx: size - 16 - 13 * i, cy: 36, r: 3.5, class: `light ${ledColor(kind, led)}` })));
    }
    const { refused, unanswered } = app.failures(name);
    text(badge, refused && unanswered ? `${number(refused + unanswered)} failed` : failuresInWords({ refused, unanswered }));
  });
  return svg("a", { href: `#/${encodeURIComponent(name)}`, transform: `translate(${x} ${y})`, class: "box" },
    svg("title", {}, `${name}, ${kind}`), svg("rect", { width: size, height: BOX.height, rx: 7 }),
    svg("text", { x: 14, y: 23, class: "box-name" }, short(name, (size - 44) / 9)), svg("text", { x: 14, y: 40, class: "box-kind" }, kind), lamp, lights, figure, badge);
}

/** A motor below its drive: its shaft, and beside it name and speed. */
function motorSign(name, size, x, y, changes) {
  const shaft = svg("line", { x1: 0, x2: 0, y1: -5, y2: -15, class: "shaft-mark" });
  const rpm = svg("text", { x: 28, y: 13, class: "box-figure" });
  changes.set(`motor ${name}`, state => {
    const now = state.motors?.[name];
    if (!now) return;
    attr(shaft, "transform", `rotate(${(((now.revolutions % 1) + 1) % 1 * 360).toFixed(1)})`);
    text(rpm, `${number(now.rpm)} rpm`);
  });
  return svg("g", { transform: `translate(${x + MOTOR.x} ${y + MOTOR.y})`, class: "motor-sign" }, svg("title", {}, `Motor ${name}`),
    svg("line", { x1: 0, x2: 0, y1: -MOTOR.y, y2: -MOTOR.radius, class: "tap motor" }), svg("circle", { r: MOTOR.radius }), shaft,
    svg("text", { x: 28, y: -3, class: "box-kind" }, short(name, (size - MOTOR.x - 66) / 6.6)), rpm);
}
