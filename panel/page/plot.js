// Position and speed over time, drawn by hand on a canvas. Each pixel column shows the least and the greatest value
// of its samples, so that zooming out hides no step.

import { attr, button, card, el, text } from "./dom.js";
import { clock, number } from "./format.js";

const MARKS = 500;
const SPANS = [5, 30, 120, 600];
const LEFT = 62, RIGHT = 14, TOP = 16, BETWEEN = 30, BOTTOM = 24;

/** A plot of samples (history.js). */
export function plotCard(units, samples) {
  const marks = []; // refused messages: {at, text}
  let span = 30, end = null; // `end` is null while the plot follows the present
  let cursor = null, dirty = false, said = "", colors, width = 0, height = 0, ratio = 1;

  const canvas = el("canvas", {
    tabindex: 0, role: "application", "aria-roledescription": "plot", "aria-label":
      "Position and speed over time. Left and right move the cursor, plus and minus zoom, space pauses, End shows the present.",
  });
  const context = canvas.getContext("2d");
  const readout = el("p", { class: "readout", "aria-live": "off" });
  const spans = SPANS.map(seconds => button(seconds < 60 ? `${seconds} s` : `${seconds / 60} min`, { "aria-pressed": seconds === span }, () => zoomTo(seconds)));
  const pause = button("Pause", { class: "toggle", "data-action": "plot-pause", "aria-pressed": false }, () => hold(end === null));
  const legend = el("div", { class: "legend", "aria-hidden": "true" }, el("span", { class: "of-position" }, "position"), el("span", { class: "of-speed" }, "speed"));
  const head = el("div", { class: "tools" }, legend, el("div", { class: "segments", role: "group", "aria-label": "Time span" }, spans), pause);
  const node = card("Motion over time", { class: "plot" }, head, el("div", { class: "canvas-box" }, canvas), readout);

  const present = () => samples.end;
  const right = () => end ?? present();
  const hold = yes => {
    end = yes ? right() : null;
    attr(pause, "aria-pressed", yes);
    text(pause, yes ? "Live" : "Pause");
    ask();
  };
  const zoomTo = (seconds, around = null) => {
    const next = Math.min(3600 * 24, Math.max(0.02, seconds));
    if (end !== null && around !== null) end = around + (end - around) * (next / span);
    span = next;
    spans.forEach((chip, i) => attr(chip, "aria-pressed", Math.abs(SPANS[i] - span) < 0.01));
    ask();
  };
  const pan = seconds => {
    if (end === null) hold(true);
    end = Math.min(present() + span * 0.2, Math.max(samples.start + span * 0.1, end + seconds));
    ask();
  };
  const ask = () => {
    if (dirty) return;
    dirty = true;
    requestAnimationFrame(() => dirty && draw());
  };

  const timeAt = x => right() - span * (1 - (x - LEFT) / (width - LEFT - RIGHT));
  const xAt = time => LEFT + (1 - (right() - time) / span) * (width - LEFT - RIGHT);

  // Pointer: hovering shows values, dragging moves the window, two fingers or the wheel zoom.
  const pointers = new Map();
  let pinch = 0;
  canvas.addEventListener("pointerdown", event => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, event.offsetX);
    pinch = spread();
  });
  const spread = () => {
    const [a, b] = pointers.values();
    return b === undefined ? 0 : Math.abs(a - b);
  };
  canvas.addEventListener("pointermove", event => {
    const earlier = pointers.get(event.pointerId);
    if (earlier !== undefined) {
      pointers.set(event.pointerId, event.offsetX);
      if (pointers.size === 1 && event.offsetX !== earlier) pan(-(event.offsetX - earlier) / (width - LEFT - RIGHT) * span);
      else if (pointers.size === 2) {
        const now = spread();
        if (pinch > 0 && now > 0) zoomTo(span * pinch / now, timeAt(event.offsetX));
        pinch = now;
      }
    }
    cursor = timeAt(event.offsetX);
    ask();
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, event => pointers.delete(event.pointerId));
  canvas.addEventListener("pointerleave", () => {
    cursor = null;
    ask();
  });
  canvas.addEventListener("wheel", event => {
    event.preventDefault();
    if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) pan(event.deltaX / width * span);
    else zoomTo(span * Math.exp(Math.max(-120, Math.min(120, event.deltaY)) * 0.004), timeAt(event.offsetX));
  }, { passive: false });
  canvas.addEventListener("keydown", event => {
    const step = span / 60;
    const keys = {
      ArrowLeft: () => moveCursor(-step), ArrowRight: () => moveCursor(step), "+": () => zoomTo(span / 1.5, cursor), "=": () => zoomTo(span / 1.5, cursor),
      "-": () => zoomTo(span * 1.5, cursor), " ": () => hold(end === null), PageUp: () => pan(-span / 2), PageDown: () => pan(span / 2),
      Home: () => { hold(true); end = samples.start + span; ask(); }, End: () => { cursor = null; hold(false); }, Escape: () => { cursor = null; ask(); },
    };
    const action = keys[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  });
  const moveCursor = seconds => {
    attr(readout, "aria-live", "polite");
    cursor = Math.min(present(), Math.max(samples.start, (cursor ?? right()) + seconds));
    if (cursor < right() - span) pan(cursor - (right() - span));
    if (cursor > right()) pan(cursor - right());
    ask();
  };
  canvas.addEventListener("blur", () => attr(readout, "aria-live", "off"));

  const readColors = () => {
    const style = getComputedStyle(canvas);
    const of = name => style.getPropertyValue(name).trim();
    colors = { position: of("--position"), speed: of("--speed"), line: of("--line"), muted: of("--muted"), ink: of("--ink"), bad: of("--bad"), screen: of("--screen") };
    ask();
  };
  const resize = () => {
    ratio = devicePixelRatio;
    width = canvas.clientWidth;
    height = canvas.clientHeight;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    if (!width) return;
    readColors();
    draw();
  };
  const observer = new ResizeObserver(resize);
  observer.observe(canvas);
  addEventListener("theme", readColors);

  const draw = () => {
    dirty = false;
    if (!width || !colors) return;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    context.font = `11px ${getComputedStyle(canvas).fontFamily}`;
    context.lineJoin = "round";
    const band = (height - TOP - BETWEEN - BOTTOM) / 2;
    drawTimes(height - BOTTOM);
    drawBand(samples.position, TOP, band, colors.position, "position", units.position);
    drawBand(samples.speed, TOP + band + BETWEEN, band, colors.speed, "speed", units.speed);
    drawMarks(height - BOTTOM);
    drawCursor(height - BOTTOM);
  };

  /** The time axis: distances from the present, or bench time while the plot is held. */
  const drawTimes = bottom => {
    const least = span / Math.max(2, Math.min(8, (width - LEFT - RIGHT) / 90));
    const inMinutes = span > 100;
    const step = inMinutes ? [15, 30, 60, 120, 300, 600, 1800, 3600].find(step => step >= least) ?? 3600 * nice(least / 3600) : nice(least);
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    context.textBaseline = "top";
    context.textAlign = "center";
    const from = end === null ? 0 : right();
    const first = end === null ? 0 : Math.floor(from / step) * step - from;
    for (let offset = first; offset >= -span - 1e-9; offset -= step) {
      if (end !== null && from + offset < -1e-9) break; // the bench began at 0
      const x = Math.round(xAt(right() + offset)) + 0.5;
      rule(x, TOP, x, bottom);
      const label = end !== null ? clock(Math.max(0, from + offset), digits) : offset === 0 ? "now" : inMinutes ? `${number(offset / 60, step >= 60 ? 0 : step === 30 ? 1 : 2)} min` : `${number(offset, digits)} s`;
      context.fillStyle = colors.muted;
      context.textAlign = x > width - RIGHT - 20 ? "right" : x < LEFT + 16 ? "left" : "center";
      context.fillText(label, x, bottom + 8);
    }
  };

  const rule = (x1, y1, x2, y2, color = colors.line, dash = []) => {
    context.strokeStyle = color;
    context.lineWidth = 1;
    context.setLineDash(dash);
    context.beginPath();
    context.moveTo(x1, y1);
    context.lineTo(x2, y2);
    context.stroke();
    context.setLineDash([]);
  };

  const drawBand = (values, top, band, color, name, unit) => {
    const from = Math.max(0, samples.before(right() - span));
    const to = Math.min(samples.count - 1, samples.before(right()) + 1);
    let least = Infinity, greatest = -Infinity;
    for (let i = from; i <= to; i++) {
      const value = values[samples.index(i)];
      if (value < least) least = value;
      if (value > greatest) greatest = value;
    }
    if (least > greatest) least = greatest = 0;
    if (name === "speed") {
      least = Math.min(0, least);
      greatest = Math.max(0, greatest);
    }
    if (least === greatest) {
      least -= 1;
      greatest += 1;
    }
    const step = nice((greatest - least) / Math.max(2, band / 34));
    const low = Math.floor(least / step + 1e-9) * step, high = Math.ceil(greatest / step - 1e-9) * step;
    const y = value => top + band * (1 - (value - low) / (high - low));
    context.textAlign = "right";
    context.textBaseline = "middle";
    for (let value = low; value <= high + step / 2; value += step) {
      const line = Math.round(y(value)) + 0.5;
      rule(LEFT, line, width - RIGHT, line);
      context.fillStyle = colors.muted;
      context.fillText(label(Math.abs(value) < step / 1e6 ? 0 : value, step, Math.max(Math.abs(low), Math.abs(high))), LEFT - 8, line);
    }
    context.textAlign = "left";
    context.textBaseline = "bottom";
    context.fillStyle = color;
    context.fillText(`${name}, ${unit}`, LEFT + 2, top - 3);
    if (!samples.count) return;

    context.save();
    context.beginPath();
    context.rect(LEFT, top - 2, width - LEFT - RIGHT, band + 4);
    context.clip();
    context.beginPath();
    let pixel = NaN, min = 0, max = 0, last = 0, x = 0, startX = 0;
    const flush = () => {
      if (min !== max) {
        context.lineTo(x, y(min));
        context.lineTo(x, y(max));
        context.lineTo(x, y(last));
      }
    };
    for (let i = from; i <= to; i++) {
      const index = samples.index(i), value = values[index], at = xAt(samples.at[index]);
      const column = Math.floor(at * ratio);
      if (column === pixel) {
        min = Math.min(min, value);
        max = Math.max(max, value);
        last = value;
        continue;
      }
      if (i > from) flush();
      pixel = column;
      min = max = last = value;
      x = at;
      if (i === from) {
        startX = at;
        context.moveTo(at, y(value));
      } else context.lineTo(at, y(value));
    }
    flush();
    if (to === samples.count - 1) context.lineTo(x = xAt(Math.max(samples.end, Math.min(right(), present()))), y(last));
    context.strokeStyle = color;
    context.lineWidth = 1.6;
    context.stroke();
    if (name === "speed") {
      context.lineTo(x, y(0));
      context.lineTo(startX, y(0));
      context.closePath();
      context.globalAlpha = 0.12;
      context.fillStyle = color;
      context.fill();
      context.globalAlpha = 1;
    }
    context.restore();
    if (end === null) {
      context.beginPath();
      context.arc(width - RIGHT, y(values[samples.index(samples.count - 1)]), 2.8, 0, 7);
      context.fillStyle = color;
      context.fill();
    }
  };

  /** A tick below the time axis for each refused message. */
  const drawMarks = bottom => {
    context.fillStyle = colors.bad;
    for (const { at } of marks) {
      const x = xAt(at);
      if (x < LEFT || x > width - RIGHT) continue;
      context.beginPath();
      context.moveTo(x, bottom - 1);
      context.lineTo(x - 4, bottom + 6);
      context.lineTo(x + 4, bottom + 6);
      context.fill();
    }
  };

  const drawCursor = bottom => {
    const time = cursor ?? right();
    const at = samples.value(time);
    const now = el => number(el, 0);
    const shown = [];
    if (cursor !== null && at) {
      const x = Math.round(xAt(cursor)) + 0.5;
      if (x >= LEFT && x <= width - RIGHT) rule(x, TOP, x, bottom, colors.ink);
      const near = marks.findLast(mark => Math.abs(xAt(mark.at) - x) < 5);
      shown.push(["at", `${clock(time)} s`, ""], ["position", `${now(at.position)} ${units.position}`, "of-position"], ["speed", `${number(at.speed, 1)} ${units.speed}`, "of-speed"]);
      if (near) shown.push(["", near.text, "of-refused"]);
    } else shown.push(["", end === null ? "Point at the plot to read values; the wheel zooms, dragging goes back in time." : `Held. The last ${number(Math.max(0, present() - samples.start))} s are kept.`, "of-hint"]);
    const words = shown.flat().join("|");
    if (words === said) return;
    said = words;
    readout.replaceChildren(...shown.map(([term, value, style]) => el("span", { class: style }, term ? el("i", {}, `${term} `) : null, value)));
  };

  return {
    node,
    mark(frame) {
      marks.push({ at: frame.at, text: `${frame.text}: ${frame.outcome}` });
      if (marks.length > MARKS) marks.shift();
    },
    draw,
    close() {
      observer.disconnect();
      removeEventListener("theme", readColors);
    },
  };
}

/** The next greater of 1, 2 and 5 times a power of ten. */
function nice(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  const part = value / power;
  return (part <= 1 ? 1 : part <= 2 ? 2 : part <= 5 ? 5 : 10) * power;
}

/** The label of a tick, with as many digits as the distance of the ticks needs. */
function label(value, step, greatest) {
  if (value === 0) return "0";
  const digits = unit => Math.max(0, Math.ceil(-Math.log10(step / unit) - 1e-9));
  if (greatest >= 1e6 && digits(1e6) < 3) return `${number(value / 1e6, digits(1e6))} M`;
  if (greatest >= 1e4 && digits(1e3) < 2) return `${number(value / 1e3, digits(1e3))} k`;
  return number(value, digits(1));
}
