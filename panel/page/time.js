// The bench's clock: real, N times faster, or manual with advance and "to the next event".

import { attr, button, el, greyed, numberOf, text } from "./dom.js";
import { clock } from "./format.js";

export function timeControl(app, node) {
  const now = el("span", { class: "clock", "data-time": "", role: "timer", "aria-label": "Bench time" });
  const factor = el("input", { type: "number", min: 1, max: 1000, step: 1, value: 10, class: "tiny", "aria-label": "Times faster than real time" });
  const set = mode => app.act("PUT", "time", { mode });
  const faster = () => {
    const times = numberOf(factor, "The factor", 1, 1000);
    if (times !== null) set(`x${times}`);
  };
  const real = button("Real", { "data-action": "time-real" }, () => set("real"));
  const times = button("×", { "data-action": "time-faster", "aria-label": "Faster than real time" }, faster);
  const manual = button("Manual", { "data-action": "time-manual" }, () => set("manual"));
  factor.addEventListener("change", faster);
  const modes = el("div", { class: "segments", role: "group", "aria-label": "Time mode" }, real, el("span", { class: "joined" }, times, factor), manual);

  const seconds = el("input", { type: "number", min: 0, max: 86400, step: "any", value: 0.1, class: "small", "aria-label": "Seconds to advance" });
  const busy = async body => {
    steps.setAttribute("aria-busy", "true");
    await app.act("POST", "time/advance", body);
    steps.removeAttribute("aria-busy");
  };
  const advance = button("Advance", { "data-action": "advance" }, () => {
    const step = numberOf(seconds, "Advance", 0, 86400, false);
    if (step !== null) busy({ seconds: step });
  });
  const next = button("Next event", { "data-action": "advance-next" }, () => busy({ to: "next" }));
  seconds.addEventListener("keydown", event => event.key === "Enter" && advance.click());
  const steps = el("div", { class: "steps", hidden: true }, seconds, el("span", { class: "unit" }, "s"), advance, next);
  const wrap = el("div", { class: "modes" }, modes);
  node.append(now, wrap, steps);

  return {
    update({ changes }) {
      const { time, cannot } = app.store.state;
      if (!time) return;
      text(now, `${clock(time.seconds)} s`);
      attr(now, "data-value", time.seconds);
      if (!changes.time?.mode && !changes.cannot) return;
      attr(now, "data-state", time.mode);
      attr(real, "aria-pressed", time.mode === "real");
      attr(times, "aria-pressed", time.mode.startsWith("x"));
      attr(manual, "aria-pressed", time.mode === "manual");
      if (time.mode.startsWith("x") && document.activeElement !== factor) factor.value = time.mode.slice(1);
      steps.hidden = time.mode !== "manual";
      greyed(wrap, cannot?.time);
      greyed(steps, cannot?.advance);
    },
  };
}
