// A drive: screens on the left, its front and the controls of the bench on the right.

import { attr, button, card, el, greyed, text } from "./dom.js";
import { dial, stepsPerTurn } from "./dial.js";
import { encoderCard } from "./encoder.js";
import { face } from "./face.js";
import { countOf } from "./history.js";
import { lineCard } from "./line.js";
import { plotCard } from "./plot.js";
import { programCard } from "./program.js";
import { pulsesCard } from "./pulses.js";
import { registersCard } from "./registers.js";
import { terminalCard, textPorts } from "./terminal.js";
import { trafficCard } from "./traffic.js";
import { failuresInWords, number } from "./format.js";

/** What positions and speeds of a kind are in. */
const unitsOf = kind => (/^(rs|mdrobot|qsb-[ds])/.test(kind) ? { position: "counts", speed: "counts/s" } : { position: "steps", speed: "steps/s" });

export function driveView(app, name) {
  const node = el("article", { class: "drive", "data-drive": name, "aria-label": `Drive ${name}` });
  const store = app.store;
  const units = unitsOf(store.state.drive.kind);
  const plot = plotCard(units, app.histories.of(name));
  let parts = null, closed = false;

  const build = kind => {
    const state = store.state.drive;
    const head = header(app, name, kind);
    const traffic = trafficCard(app, { drive: name });
    const registers = registersCard(app, name, kind);
    const front = face(app, name, kind, state);
    const faults = Object.keys(state.faults ?? {}).length ? faultsCard(app, name) : null;
    const encoder = kind.encoders.length ? encoderCard(app, name) : null;
    const pulses = pulsesCard(app, name, kind, state.pins);
    const program = programCard(app, kind);
    registers.node.classList.toggle("bounded", /^(rs|mdrive|qsb)/.test(kind.kind)); // a terminal or a program follows
    const terminals = textPorts(kind).map(port => terminalCard(app, name, kind, port));
    const lines = Object.entries(store.state.buses ?? {}).filter(([, bus]) => bus.drives.includes(name)).map(([bus]) => lineCard(app, bus));
    const shaft = kind.axes.length ? dial(units) : null;
    const statistics = statisticsCard(app);
    const motion = shaft ? el("div", { class: "motion" }, card("Motor", { class: "motor-card" }, null, shaft.node), plot.node)
      : countOf(state) !== undefined ? el("div", { class: "motion alone" }, plot.node) : null;
    const limits = kind.not_modelled.length ? el("details", { class: "card limits" }, el("summary", {}, `Not modelled (${kind.not_modelled.length})`), el("ul", {}, kind.not_modelled.map(line => el("li", {}, line)))) : null;
    const buttons = app.backend.buttons?.(app, name); // of a site
    node.replaceChildren(head.node, ...(buttons ? [buttons.node] : []),
      el("div", { class: "columns" },
        el("div", { class: "screens" }, motion, traffic.node, registers.node, terminals.map(terminal => terminal.node), program.node),
        el("div", { class: "controls" }, front.node, encoder?.node, pulses?.node, faults?.node, lines.map(line => line.node), statistics.node, limits)));
    parts = { head, buttons, traffic, registers, front, faults, program, terminals, lines, shaft, statistics };
    update({ changes: {}, traffic: waiting, leftOut: 0, whole: true });
  };
  let waiting = []; // frames that came before the description of the kind
  app.kind(store.state.drive.kind).then(kind => {
    if (closed) return;
    if (!kind) node.replaceChildren(el("p", { class: "empty" }, "The description of this kind of drive could not be read. Reload the page to try again."));
    else build(kind);
  });

  const update = news => {
    if (!parts) {
      waiting = [...waiting, ...news.traffic].slice(-300);
      return;
    }
    const state = store.state.drive;
    if (!state) return;
    attr(node, "data-state", state.powered ? "on" : "off");
    for (const part of [parts.head, parts.buttons, parts.traffic, parts.registers, parts.front, parts.faults, parts.program, parts.statistics, ...parts.lines]) part?.update(news);
    for (const frame of news.traffic) {
      parts.registers.take(frame);
      if (frame.verdict === "refused") plot.mark(frame);
    }
    if (parts.shaft && (news.whole || news.changes.drive?.motion || news.changes.motors)) {
      const motor = Object.values(store.state.motors ?? {}).find(motor => motor.drive === name);
      parts.shaft.update(state.motion, motor, stepsPerTurn(state.kind, state.registers));
    }
    if (news.whole || news.changes.time) plot.draw();
  };

  return {
    node,
    kind: store.state.drive.kind,
    update,
    close() {
      closed = true;
      plot.close();
      parts?.registers.close();
      parts?.terminals.forEach(terminal => terminal.close());
    },
  };
}

/** Drives whose power fails in their next save, as far as this page knows: the bench does not tell. Each has the notice that said so. */
const cuts = new Map();

/** Name, product and power. */
function header(app, name, kind) {
  const power = action => app.act("POST", `drives/${encodeURIComponent(name)}/power`, { action });
  const now = () => app.store.state.time?.seconds ?? 0;
  let isOff = false, cycledAt = -1; // this page has switched the power off; bench time of its last cycle, which is a tick without power
  const off = async () => {
    isOff = true;
    if (!(await power("off")).ok) isOff = false;
  };
  const arm = note => {
    cuts.get(name)?.remove();
    if (note) cuts.set(name, note);
    else cuts.delete(name);
    attr(cut, "aria-pressed", cuts.has(name));
  };
  const on = button("On", { "data-action": "power-on" }, () => power("on"));
  const offButton = button("Off", { "data-action": "power-off" }, off);
  const cycle = button("Cycle", { "data-action": "power-cycle", title: "Off, and at once on again" }, () => {
    cycledAt = now();
    power("cycle");
  });
  const cut = button("Cut in next save", { "data-action": "power-cut", "aria-pressed": cuts.has(name), title: "The drive runs on, until its power fails in the middle of its next save. Off and on do not change this." }, async () => {
    if ((await power("cut")).ok) arm(app.say("The power fails in the middle of the next save of this drive, also if it was off before."));
  });
  const group = el("div", { class: "segments", role: "group", "aria-label": "Power" }, on, offButton, cycle, cut);
  const wrap = el("div", { class: "power" }, el("span", { class: "hint" }, "Power"), group);
  const refused = el("a", { href: "#traffic", class: "badge big", hidden: true });
  refused.addEventListener("click", event => {
    // The hash is the route: show the traffic without changing it.
    event.preventDefault();
    document.getElementById("traffic").scrollIntoView({ behavior: "smooth", block: "start" });
    document.querySelector("#traffic [data-filter=refused]").click();
  });
  const node = el("header", { class: "drive-head" },
    el("div", {}, el("h1", { title: name.length > 60 ? name : null }, name), el("p", { class: "product" }, kind.product, el("code", {}, kind.kind), el("span", { class: "manual" }, kind.manual))), refused, wrap);
  return {
    node,
    update({ changes, whole }) {
      const drive = app.store.state.drive;
      if (whole || changes.drive?.powered !== undefined) {
        attr(node, "data-state", drive.powered ? "on" : "off");
        attr(on, "aria-pressed", drive.powered);
        attr(offButton, "aria-pressed", !drive.powered);
        if (drive.powered) isOff = false;
        else if (!isOff && now() - cycledAt > 1e-3) arm(null); // the cut has come
      }
      if (whole || changes.cannot !== undefined) {
        greyed(wrap, app.cannot("power"));
        const reason = app.cannot("power", "cut");
        cut.disabled = Boolean(reason);
        if (reason) attr(cut, "title", reason);
      }
      if (whole || changes.drives || changes.buses) {
        // Messages on its line that were for no drive, or corrupt, had no answer either.
        const lines = Object.values(app.store.state.buses ?? {}).filter(bus => bus.drives.includes(name));
        const failures = app.failures(name);
        for (const line of lines) failures.unanswered += line.unanswered ?? 0;
        const words = failuresInWords(failures);
        refused.hidden = words === "";
        refused.classList.toggle("warn", failures.refused === 0); // as in the list
        text(refused, words);
      }
    },
  };
}

/** Causes of faults as switches. */
function faultsCard(app, name) {
  const switches = new Map();
  const list = el("div", { class: "switches" });
  for (const fault of Object.keys(app.store.state.drive.faults)) {
    const toggle = button(el("span", {}, fault.replaceAll("_", " ")), { "data-fault": fault, role: "switch", "aria-checked": false, class: "switch" }, () =>
      app.act(toggle.dataset.state === "on" ? "DELETE" : "PUT", `drives/${encodeURIComponent(name)}/faults/${fault}`));
    switches.set(fault, toggle);
    list.append(toggle);
  }
  return {
    node: card("Faults", { class: "faults" }, el("span", { class: "hint" }, "causes; they stay until switched off"), list),
    update({ changes, whole }) {
      if (!whole && !changes.drive?.faults) return;
      for (const [fault, isSet] of Object.entries(app.store.state.drive.faults)) {
        const toggle = switches.get(fault);
        if (!toggle) continue;
        attr(toggle, "data-state", isSet ? "on" : "off");
        attr(toggle, "aria-checked", isSet);
      }
    },
  };
}

const COUNTED = {
  requests: "executed", refused: "refused", dropped: "ignored", crc: "wrong checksum", gap: "with a gap", length: "wrong length",
  spoiled: "with character errors", foreign: "for another address", starting: "during start-up", connected: "connected", connections: "connections", broken: "broken", messages: "messages",
};

/** What the ports have counted. */
function statisticsCard(app) {
  const list = el("dl", { class: "statistics" });
  return {
    node: card("Ports", { class: "ports" }, null, list),
    update({ changes, whole }) {
      if (!whole && !changes.drive?.ports) return;
      list.replaceChildren(...Object.entries(app.store.state.drive.ports).flatMap(([port, counts]) => {
        const shown = Object.entries(counts).filter(([key, value]) => COUNTED[key] && (value > 0 || key === "requests"));
        return [el("div", {}, el("dt", {}, el("b", {}, port), counts.line ? ` ${counts.line}` : " TCP"),
          el("dd", {}, shown.map(([key, value]) => el("span", { class: ["refused", "crc"].includes(key) ? "bad" : "", "data-counted": key, "data-value": value }, el("b", {}, number(value)), ` ${COUNTED[key]}`))))];
      }));
    },
  };
}
