// Faults of a line or TCP port, as sliders. A call sets all faults at once, so each change sends all of them.

import { attr, button, card, el, greyed, numberOf, text } from "./dom.js";
import { number, percent } from "./format.js";

const RATES = [
  ["drop", "Lose frames"], ["corrupt", "Flip a bit"], ["duplicate", "Send twice"], ["truncate", "Cut the end"], ["noise", "Add noise"],
  ["wrong_address", "Answer from another address"], ["exception", "Answer with an exception"],
  ["wrong_transaction", "Wrong transaction number", "tcp"], ["close", "Close the connection", "tcp"],
];
const STEPS = 40; // of a slider of a rate
const MOST_DELAY = 1000; // milliseconds

/** Rates are cubic along a slider, so that 0.1 % can be chosen as well as 100 %. */
const rateAt = step => Number(((step / STEPS) ** 3).toPrecision(2));
const stepOf = rate => Math.round(STEPS * Math.cbrt(rate));

export function lineCard(app, name, attributes = {}) {
  const bus = () => app.store.state.buses?.[name];
  const rows = [];
  const info = el("p", { class: "line-info" });
  const send = async change => {
    const faults = { ...bus()?.faults, ...change };
    const body = Object.fromEntries(Object.entries(faults).filter(([key, value]) =>
      key !== "exception_code" && value !== 0 && value !== false && value !== null));
    if (faults.exception) body.exception_code = numberOf(code, "Exception", 1, 255) ?? faults.exception_code ?? 4;
    await app.act("PUT", `buses/${encodeURIComponent(name)}/faults`, body);
  };

  const slider = (key, label, most, words, toValue, toStep) => {
    const input = el("input", { type: "range", min: 0, max: most, value: 0, "aria-label": label, "data-line-fault": key });
    const shown = el("span", { class: "shown" });
    const show = value => {
      text(shown, words(value));
      attr(input, "aria-valuetext", words(value));
    };
    input.addEventListener("input", () => show(toValue(Number(input.value))));
    input.addEventListener("change", () => send({ [key]: toValue(Number(input.value)) }));
    const node = el("label", { class: "slider" }, el("span", {}, label), input, shown);
    rows.push(faults => {
      const value = faults[key];
      const plain = typeof value === "number";
      node.classList.toggle("on", plain ? value > 0 : Boolean(value));
      if (document.activeElement !== input || !input.matches(":active")) {
        if (plain) input.value = toStep(value);
      }
      if (plain) show(value);
      else text(shown, value ? "by a rule" : "off");
      attr(node, "title", plain ? null : JSON.stringify(value));
      attr(node, "data-value", plain ? value : JSON.stringify(value));
    });
    return node;
  };

  const isTcp = !bus()?.line;
  const sliders = RATES.filter(([, , only]) => !only || isTcp).map(([key, label]) => slider(key, label, STEPS, value => (value ? percent(value) : "off"), rateAt, stepOf));
  sliders.push(slider("delay_ms", "Delay answers", MOST_DELAY, value => (value ? `${number(value)} ms` : "off"), value => value, value => Math.min(MOST_DELAY, value)));
  const mute = button("Mute", { class: "toggle", role: "switch", "aria-checked": false, title: "No answer is delivered" }, () => send({ mute: !bus()?.faults.mute }));
  const code = el("input", { type: "number", min: 1, max: 255, value: 4, class: "tiny", "aria-label": "Exception: code" });
  code.addEventListener("change", () => numberOf(code, "Exception", 1, 255) !== null && bus()?.faults.exception && send({}));
  const baud = el("select", { "aria-label": "Baud rate of the master" }, el("option", { value: "" }, "as the drive"),
    [1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400].map(rate => el("option", { value: rate }, `${rate} baud`)));
  baud.addEventListener("change", () => send({ baud: baud.value === "" ? null : Number(baud.value) }));
  const none = button("No faults", { class: "ghost", "data-action": "line-clear" }, () => app.act("PUT", `buses/${encodeURIComponent(name)}/faults`, {}));
  const controls = el("div", { class: "sliders" }, sliders);
  const more = el("div", { class: "row" }, mute, el("label", {}, "Exception ", code), isTcp ? null : el("label", {}, "Master's rate ", baud));
  const body = el("div", { class: "line-body" }, controls, more);
  const node = card(`Line ${name}`, { class: "line", "data-bus": name, ...attributes }, el("div", { class: "tools" }, none), info, body);

  return {
    node,
    update({ changes, whole }) {
      const now = bus();
      if (!now || !(whole || changes.buses?.[name] || changes.cannot)) return;
      text(info, [now.line ?? "TCP", ...now.listen, now.strict && "strict", now.early_requests && `${number(now.early_requests)} too early`].filter(Boolean).join(" · "));
      rows.forEach(draw => draw(now.faults));
      attr(mute, "aria-checked", now.faults.mute === true);
      if (document.activeElement !== code && now.faults.exception) code.value = now.faults.exception_code;
      const rate = now.faults.baud ?? "";
      if (![...baud.options].some(option => option.value === String(rate))) baud.append(el("option", { value: rate }, `${rate} baud`));
      if (document.activeElement !== baud) baud.value = rate;
      greyed(body, app.cannot("line_faults"));
    },
  };
}
