// Messages in words: what a master said, when, and how it ended. Only so many are kept; the troubled ones longer.

import { attr, button, card, el, text } from "./dom.js";
import { besideRegisters, parts } from "./bytes.js";
import { clock, duration, number } from "./format.js";

const KEPT = 1000; // frames
const KEPT_TROUBLE = 300; // frames without success, kept also when many others follow
const ROWS = 300; // rows in the document
const FLOOD = 12; // frames at a time from which on only the newest rows are drawn, seven times per second
const FLOOD_ROWS = 20;
const FLOOD_PAUSE = 140; // milliseconds

/** True for a message without success: what a person looks for whose master gets no answer. */
const hasFailed = frame => frame.verdict === "refused" || frame.unanswered === true;

const FILTERS = [
  ["all", "All", () => true],
  ["refused", "Refused or unanswered", frame => hasFailed(frame)],
];

/** The words for each verdict. */
const VERDICTS = {
  refused: "refused", "without effect": "no effect", "not for it": "not for it", "bad frame": "bad frame",
  "too early": "too early", "not listening": "not listening", lost: "lost",
};

export function trafficCard(app, { drive = null } = {}) {
  const all = [], trouble = [];
  const before = new Map(); // time of the last message, by port
  let filter = FILTERS[0], words = "", failed = 0, total = 0, lastNumber = 0, lastSent = -1, lastAt = 0;

  const chips = FILTERS.map(entry => button(entry[1], { "data-filter": entry[0], "aria-pressed": entry === filter }, () => choose(entry)));
  const search = el("input", { type: "search", placeholder: "Filter", "aria-label": "Filter messages by text", class: "filter", autocomplete: "off", spellcheck: "false" });
  const clear = button("Clear", { class: "ghost" }, () => {
    all.length = trouble.length = failed = 0;
    count();
    show();
  });
  const rows = el("ol", { class: "frames" });
  const empty = el("p", { class: "empty" });
  const scroller = el("div", { class: "frames-scroll", tabindex: "0", role: "region", "aria-label": "Messages, newest last; the arrow keys go through them" }, el("div", {}, empty, rows));
  const latest = button("Newest ↓", { class: "latest", hidden: true }, () => show());
  const head = el("div", { class: "tools" }, el("div", { class: "segments", role: "group", "aria-label": "Which messages" }, chips), search, clear);
  const node = card("Traffic", { class: `traffic ${drive ? "" : "of-all"}`, id: "traffic" }, head, el("div", { class: "frames-box" }, scroller, latest));

  const passes = frame => filter[2](frame) &&
    (words === "" || `${frame.text} ${frame.outcome} ${frame.drive} ${frame.verdict}`.toLowerCase().includes(words));
  const count = () => {
    text(chips[1], failed ? `${FILTERS[1][1]} ${number(failed)}` : FILTERS[1][1]);
    chips[1].classList.toggle("has-refused", failed > 0);
  };
  const choose = entry => {
    filter = entry;
    chips.forEach((chip, index) => attr(chip, "aria-pressed", FILTERS[index] === entry));
    show();
  };
  search.addEventListener("input", () => {
    words = search.value.trim().toLowerCase();
    show();
  });
  // The list keeps its end in sight by itself: panel.css reverses its direction, so that its end is at scroll offset 0. Nothing
  // here asks for a height, which would cost a layout for each update.
  let missed = 0, flooded = 0, settled = 0; // frames that are not drawn while one reads; time of the last flood that was drawn
  let atEnd = true, ours = 0; // `ours` is the offset that an open frame was given below
  const isOpen = () => rows.querySelector(".frame-details") !== null;
  scroller.addEventListener("scroll", () => {
    if (ours && scroller.scrollTop === ours) return;
    atEnd = scroller.scrollTop > -30;
    if (missed && atEnd && !isOpen()) show();
    latest.hidden = atEnd;
  }, { passive: true });

  // One stop of the Tab key for the whole list; the arrow keys go from frame to frame.
  scroller.addEventListener("keydown", event => {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!step || !rows.childElementCount) return;
    const here = event.target.closest("[data-traffic]");
    let next = here ?? rows.lastElementChild;
    if (here) do next = step > 0 ? next.nextElementSibling : next.previousElementSibling; while (next && !next.dataset.traffic);
    if (!next) return;
    event.preventDefault();
    next.querySelector("button").focus();
  });

  /** Opens or closes a row. Its head stays where it is, or moves up just so far that the whole row is in sight. */
  const keep = async (row, frame, change) => {
    // The kind is known before the row opens, so that its height does not change later.
    const name = frame.verdict === "refused" ? app.store.state.drives?.[frame.drive]?.kind : undefined;
    const registers = name === undefined ? [] : (await app.kind(name))?.registers ?? [];
    const top = () => row.getBoundingClientRect().top;
    const earlier = top();
    change(registers);
    scroller.scrollTop += top() - earlier;
    const { top: above, bottom: below } = scroller.getBoundingClientRect();
    scroller.scrollTop += Math.max(0, Math.min(row.getBoundingClientRect().bottom - below, top() - above));
    ours = isOpen() ? scroller.scrollTop : 0;
  };

  /** Draws the list anew, after another filter. */
  const show = (most = ROWS) => {
    const source = filter === FILTERS[0] ? all : trouble;
    missed = 0;
    latest.hidden = true;
    rows.replaceChildren(...source.filter(passes).slice(-most).map(frame => row(frame, drive, keep)));
    empty.hidden = rows.childElementCount > 0;
    if (total) text(empty, "No message passes the filter.");
    if (!atEnd || ours) scroller.scrollTop = 0;
    atEnd = true;
    ours = 0;
  };

  const note = () => {
    const reason = app.cannot("traffic");
    if (total) return;
    if (reason) return text(empty, `No messages are shown: ${reason}.`);
    const lines = Object.values(app.store.state.buses ?? {}).filter(bus => !drive || bus.drives.includes(drive)).slice(0, 3);
    const places = lines.filter(bus => bus.listen.length).map(bus => bus.listen.join(" or ") + (bus.line ? ` with ${bus.line}` : ""));
    text(empty, (drive ? `No message has come to ${drive} yet.` : "No master has sent anything yet.") + (drive && places.length ? ` A master reaches it at ${places.join(" and ")}.` : ""));
  };

  return {
    node,
    update({ traffic: news, leftOut, whole, changes }) {
      if (whole || changes.cannot !== undefined) note();
      if (whole && (app.store.state.time?.seconds ?? 0) < lastAt) {
        all.length = trouble.length = failed = lastNumber = lastAt = 0; // another bench
        lastSent = -1;
        before.clear();
        show();
      }
      // After a reconnection the latest messages come again.
      const known = whole ? lastSent : -1;
      const traffic = news.filter(frame => (frame.sent ? frame.at > known : frame.number > lastNumber));
      if (whole && total) leftOut = 0;
      if (!traffic.length && !leftOut) return;
      const fresh = [];
      if (leftOut) fresh.push(el("li", { class: "left-out" }, `${number(leftOut)} earlier ${leftOut === 1 ? "message is" : "messages are"} not shown`));
      for (const frame of traffic) {
        total++;
        const line = `${frame.drive ?? frame.bus}.${frame.port}`;
        const earlier = before.get(line);
        frame.gap = earlier === undefined ? null : Math.max(0, frame.at - earlier);
        before.set(line, frame.at);
        if (frame.sent) lastSent = frame.at;
        else lastNumber = frame.number;
        lastAt = Math.max(lastAt, frame.at);
        all.push(frame);
        if (hasFailed(frame)) {
          trouble.push(frame);
          failed++;
        }
      }
      if (all.length > KEPT) all.splice(0, all.length - KEPT);
      if (trouble.length > KEPT_TROUBLE) trouble.splice(0, trouble.length - KEPT_TROUBLE);
      count();
      const passing = traffic.filter(passes);
      if (!passing.length && !fresh.length) return;
      if (ours && !isOpen()) {
        atEnd = scroller.scrollTop > -30;
        ours = 0;
      }
      const isFlood = passing.length > FLOOD && total > passing.length;
      if (!atEnd || ((isFlood || rows.childElementCount > 2 * ROWS) && isOpen())) {
        missed += passing.length; // who reads older frames shall not lose their place
      } else if (isFlood) {
        const now = performance.now();
        if (now - flooded > FLOOD_PAUSE) {
          flooded = now;
          show(FLOOD_ROWS);
        }
        // When the flood is over, all rows come back.
        clearTimeout(settled);
        settled = setTimeout(() => atEnd && !isOpen() && show(), 3 * FLOOD_PAUSE);
      } else {
        const height = isOpen() ? rows.offsetHeight : 0;
        rows.append(...fresh, ...passing.slice(-ROWS).map(frame => row(frame, drive, keep)));
        while (rows.childElementCount > ROWS && !height) rows.firstElementChild.remove();
        empty.hidden = true;
        if (height) {
          scroller.scrollTop -= rows.offsetHeight - height; // an open frame stays where it is
          ours = scroller.scrollTop;
        }
      }
      latest.hidden = atEnd && missed === 0 && !ours;
      text(latest, missed ? `Newest ↓ ${number(missed)} more` : "Newest ↓");
    },
  };
}

function row(frame, ofDrive, keep) {
  const isRead = frame.verdict === "done" && frame.text.startsWith("read ") && / = /.test(frame.outcome);
  const said = isRead ? `read ${frame.outcome}` : frame.text;
  const outcome = isRead || frame.sent || !frame.outcome || frame.outcome === "done" ? null : frame.outcome;
  const verdict = VERDICTS[frame.verdict] ?? (frame.unanswered ? "answer lost" : undefined);
  const line = button([
    el("span", { class: "at" }, clock(frame.at)),
    el("span", { class: "gap", title: "since the message before" }, frame.gap === null ? "" : `+${duration(frame.gap)}`),
    ofDrive ? null : el("span", { class: "of" }, frame.drive ?? frame.bus ?? ""),
    el("span", { class: "words" },
      el("span", { class: "said" }, frame.sent ? el("span", { class: "way", title: "sent by the drive itself" }, "← ") : null, said),
      outcome ? el("span", { class: "outcome" }, outcome) : null),
    verdict ? el("span", { class: "verdict" }, verdict) : null,
  ], { class: "frame", "aria-expanded": false, tabindex: -1 }, () => {
    keep(node, frame, registers => {
      const open = line.getAttribute("aria-expanded") !== "true";
      attr(line, "aria-expanded", open);
      if (open) node.append(details(frame, registers));
      else node.lastChild.remove();
    });
  });
  const node = el("li", { "data-traffic": frame.number ?? "sent", "data-verdict": frame.verdict, "data-unanswered": frame.unanswered, "data-at": frame.at, "data-of": frame.drive }, line);
  return node;
}

/** The bytes of a frame and of its answer, part by part. */
function details(frame, registers) {
  const hint = frame.verdict === "refused" ? besideRegisters(frame.bytes ?? "", registers) : undefined;
  const list = (title, hex, isAnswer) => el("div", { class: "bytes" }, el("h3", {}, title),
    hex ? el("dl", {}, parts(hex, isAnswer).map(([bytes, meaning]) => el("div", {}, el("dt", {}, bytes), el("dd", {}, meaning))))
      : el("p", {}, "none"));
  return el("div", { class: "frame-details" },
    frame.reason && !frame.outcome.includes(frame.reason) ? el("p", { class: "why" }, el("b", {}, "Why: "), frame.reason) : null,
    hint ? el("p", { class: "why" }, hint) : null,
    list(frame.sent ? "Sent by the drive" : "Request", frame.bytes, frame.sent ?? false),
    frame.sent ? null : list("Answer", frame.answer, true));
}
