// The motor's shaft as a dial, and its figures.

import { attr, el, svg, text } from "./dom.js";
import { number } from "./format.js";

const FRAME = 1 / 30; // seconds between two updates at most loads

/** Steps or counts of a turn, for a drive without a motor in its bench file; null if it cannot be known. */
export function stepsPerTurn(kind, registers) {
  if (kind.startsWith("md3")) return 200 << ((registers.MotorCurrentAndMicrostepping >> 8) & 15);
  if (kind.startsWith("mdrive")) return (registers.FullSteps ?? 200) * (registers.MS ?? 256);
  if (kind.startsWith("rs")) return 2 * registers.PULSES_PER_REVOLUTION * Math.max(1, registers.USE_HALL);
  if (kind.startsWith("qsb-m")) return 200;
  if (kind === "mdrobot") return 3 * ([4, 8, 10, 12, 2, 6][registers.HALL_TYPE] ?? 2 * registers.HALL_TYPE); // three counts a pole, p. 8
  return null;
}

export function dial(units) {
  const ticks = Array.from({ length: 60 }, (_, i) => svg("line", {
    x1: 0, x2: 0, y1: -92, y2: i % 5 === 0 ? -83 : -88, class: i % 5 === 0 ? "tick major" : "tick", transform: `rotate(${i * 6})`,
  }));
  const sweep = svg("path", { class: "sweep" });
  const shaft = svg("g", { class: "shaft" },
    svg("defs", {}, svg("linearGradient", { id: "steel", x1: 0, y1: 0, x2: 1, y2: 1 }, svg("stop", { offset: 0, class: "steel-light" }), svg("stop", { offset: 1, class: "steel-dark" }))),
    svg("circle", { r: 66, class: "hub" }),
    svg("circle", { r: 63, class: "hub-edge" }),
    svg("path", { d: "M-2.5-72 0-80 2.5-72Z M-1.6-72h3.2v30h-3.2z", class: "pointer" }),
    svg("path", { d: "M-13.5-16.6A21.4 21.4 0 1 0 13.5-16.6Z", class: "axle" }));
  const face = svg("svg", { viewBox: "-100 -100 200 200", class: "dial", role: "img", "aria-label": "Motor shaft" },
    svg("circle", { r: 96, class: "rim" }), ...ticks, shaft, sweep);

  const figure = (name, label, unit) => {
    const value = el("b", { "data-motion": name });
    return { value, node: el("div", {}, el("dt", {}, label), el("dd", {}, value, unit ? el("span", { class: "unit" }, unit) : null)) };
  };
  const figures = {
    position: figure("position", "Position", units.position), speed: figure("speed", "Speed", units.speed),
    turns: figure("revolutions", "Turns", ""), rpm: figure("rpm", "Shaft", "rpm"),
    current: figure("current", "Current", "A"), duty: figure("duty", "Duty", "%"),
  };
  const moving = el("span", { class: "moving", "data-motion": "moving" });
  const node = el("div", { class: "motor" }, el("div", { class: "dial-box" }, face, moving),
    el("dl", { class: "figures" }, Object.values(figures).map(entry => entry.node)));

  const show = (entry, value, words) => {
    text(entry.value, words);
    attr(entry.value, "data-value", value);
  };

  return {
    node,
    /** Draws the motion; `motor` is that of the bench file, else the steps of a turn of a usual motor are taken. */
    update(motion, motor, perTurn) {
      show(figures.position, motion.position, number(motion.position));
      show(figures.speed, motion.speed, number(motion.speed, Math.abs(motion.speed) < 100 && motion.speed !== 0 ? 1 : 0));
      show(figures.current, motion.current, number(motion.current, 2));
      show(figures.duty, motion.duty, number(motion.duty * 100));
      const turns = motor ? motor.revolutions : perTurn ? motion.position / perTurn : null;
      const rpm = motor ? motor.rpm : perTurn ? motion.speed / perTurn * 60 : null;
      figures.turns.node.hidden = figures.rpm.node.hidden = turns === null;
      if (turns !== null) {
        show(figures.turns, turns, number(turns, 3));
        show(figures.rpm, rpm, number(rpm, Math.abs(rpm) < 100 && rpm !== 0 ? 1 : 0));
        const angle = ((turns % 1) + 1) % 1 * 360;
        attr(shaft, "transform", `rotate(${angle.toFixed(2)})`);
        // A shaft that turns far between two pictures seems to stand or to turn backwards: the way it made is shaded.
        const way = Math.max(-359, Math.min(359, rpm / 60 * FRAME * 360));
        attr(sweep, "d", Math.abs(way) > 4 ? sector(angle - way, angle) : "");
      }
      const state = motor?.stalled ? "stalled" : motion.moving ? "moving" : "still";
      attr(moving, "data-state", state);
      attr(moving, "data-value", motion.moving);
      text(moving, { stalled: "stalled", moving: motion.speed < 0 ? "moving −" : "moving +", still: "standing" }[state]);
    },
  };
}

/** A ring sector between two angles in degrees, clockwise from the top. */
function sector(from, to) {
  const [a, b] = from < to ? [from, to] : [to, from];
  const point = (radius, angle) => {
    const turn = (angle - 90) * Math.PI / 180;
    return `${(radius * Math.cos(turn)).toFixed(1)} ${(radius * Math.sin(turn)).toFixed(1)}`;
  };
  const large = b - a > 180 ? 1 : 0;
  return `M${point(80, a)}A80 80 0 ${large} 1 ${point(80, b)}L${point(67, b)}A67 67 0 ${large} 0 ${point(67, a)}Z`;
}
