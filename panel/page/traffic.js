// Messages in words: what a master said, when, and how it ended. Only so many are kept; the troubled ones longer.

import { attr, button, card, el, text } from "./dom.js";
import { parts } from "./bytes.js";
import { clock, duration, number } from "./format.js";

const KEPT = 1000; // frames
const KEPT_TROUBLE = 300; // frames that were not done, kept also when many others follow
const ROWS = 300; // rows in the document

const FILTERS = [
  ["all", "All", () => true],
  ["refused", "Refused", frame => frame.verdict === "refused"],
  ["errors", "Errors", frame => frame.verdict !== "done"],
];

/** The words for each verdict. */
const VERDICTS = {
  refused: "refused", "without effect": "no effect", "not for it": "not for it", "bad frame": "bad frame",
  "too early": "too early", "not listening": "not listening", lost: "lost",
};

export function trafficCard(app, { drive = null } = {}) {
  const all = [], trouble = [];
  const before = new Map(); // time of the last message, by port
  let filter = FILTERS[0], words = "", refused = 0, total = 0, lastNumber = 0, lastAt = 0;

  const chips = FILTERS.map(entry => button(entry[1], { "data-filter": entry[0], "aria-pressed": entry === filter }, () => choose(entry)));
  const search = el("input", { type: "search", placeholder: "Filter", "aria-label": "Filter messages by text", class: "filter", autocomplete: "off", spellcheck: "false" });
  const clear = button("Clear", { class: "ghost" }, () => {
    all.length = trouble.length = 0;
    show();
  });
  const rows = el("ol", { class: "frames" });
  const empty = el("p", { class: "empty" });
  const scroller = el("div", { class: "frames-scroll", tabindex: "0", role: "region", "aria-label": "Messages, newest last" }, empty, rows);
  const latest = button("Newest ↓", { class: "latest", hidden: true }, () => {
    scroller.scrollTop = scroller.scrollHeight;
  });
  const head = el("div", { class: "tools" }, el("div", { class: "segments", role: "group", "aria-label": "Which messages" }, chips), search, clear);
  const node = card("Traffic", { class: `traffic ${drive ? "" : "of-all"}`, id: "traffic" }, head, el("div", { class: "frames-box" }, scroller, latest));

  const passes = frame => filter[2](frame) &&
    (words === "" || `${frame.text} ${frame.outcome} ${frame.drive} ${frame.verdict}`.toLowerCase().includes(words));
  const choose = entry => {
    filter = entry;
    chips.forEach((chip, index) => attr(chip, "aria-pressed", FILTERS[index] === entry));
    show();
  };
  search.addEventListener("input", () => {
    words = search.value.trim().toLowerCase();
    show();
  });
  const atEnd = () => scroller.scrollTop + scroller.clientHeight >= scroller.scrollHeight - 30;
  scroller.addEventListener("scroll", () => {
    latest.hidden = atEnd();
  }, { passive: true });

  /** Draws the list anew, after another filter. */
  const show = () => {
    const source = filter === FILTERS[0] ? all : trouble;
    rows.replaceChildren(...source.filter(passes).slice(-ROWS).map(frame => row(frame, drive)));
    empty.hidden = rows.childElementCount > 0;
    if (total) text(empty, "No message passes the filter.");
    scroller.scrollTop = scroller.scrollHeight;
  };

  const note = () => {
    const reason = app.cannot("traffic");
    if (!total) text(empty, reason ? `No messages are shown: ${reason}.` : (drive ? `No message has come to ${drive} yet.` : "No master has sent anything yet."));
  };

  return {
    node,
    update({ traffic: news, leftOut, whole, changes }) {
      if (whole || changes.cannot !== undefined) note();
      if (whole && (app.store.state.time?.seconds ?? 0) < lastAt) {
        all.length = trouble.length = refused = lastNumber = lastAt = 0; // another bench
        before.clear();
        show();
      }
      // After a reconnection the latest messages come again.
      const traffic = news.filter(frame => frame.number > lastNumber);
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
        lastNumber = frame.number;
        lastAt = Math.max(lastAt, frame.at);
        all.push(frame);
        if (frame.verdict !== "done") trouble.push(frame);
        if (frame.verdict === "refused") refused++;
      }
      if (all.length > KEPT) all.splice(0, all.length - KEPT);
      if (trouble.length > KEPT_TROUBLE) trouble.splice(0, trouble.length - KEPT_TROUBLE);
      fresh.push(...traffic.slice(-ROWS).filter(passes).map(frame => row(frame, drive)));
      if (refused) {
        text(chips[1], `Refused ${refused}`);
        chips[1].classList.add("has-refused");
      }
      if (!fresh.length) return;
      const follow = atEnd();
      rows.append(...fresh);
      while (rows.childElementCount > (follow ? ROWS : 2 * ROWS)) rows.firstElementChild.remove();
      empty.hidden = true;
      if (follow) scroller.scrollTop = scroller.scrollHeight;
      else latest.hidden = false;
    },
  };
}

function row(frame, ofDrive) {
  const isRead = frame.verdict === "done" && frame.text.startsWith("read ") && / = /.test(frame.outcome);
  const said = isRead ? `read ${frame.outcome}` : frame.text;
  const outcome = isRead || !frame.outcome || frame.outcome === "done" ? null : frame.outcome;
  const verdict = VERDICTS[frame.verdict];
  const line = button([
    el("span", { class: "at" }, clock(frame.at)),
    el("span", { class: "gap", title: "since the message before" }, frame.gap === null ? "" : `+${duration(frame.gap)}`),
    ofDrive ? null : el("span", { class: "of" }, frame.drive ?? frame.bus ?? ""),
    el("span", { class: "words" },
      el("span", { class: "said" }, frame.sent ? el("span", { class: "way", title: "sent by the drive itself" }, "← ") : null, said),
      outcome ? el("span", { class: "outcome" }, outcome) : null),
    verdict ? el("span", { class: "verdict" }, verdict) : null,
  ], { class: "frame", "aria-expanded": false }, () => {
    const open = line.getAttribute("aria-expanded") !== "true";
    attr(line, "aria-expanded", open);
    if (open) node.append(details(frame));
    else node.lastChild.remove();
  });
  const node = el("li", { "data-traffic": frame.number, "data-verdict": frame.verdict, "data-at": frame.at, "data-of": frame.drive }, line);
  return node;
}

/** The bytes of a frame and of its answer, part by part. */
function details(frame) {
  const list = (title, hex, isAnswer) => el("div", { class: "bytes" }, el("h3", {}, title),
    hex ? el("dl", {}, parts(hex, isAnswer).map(([bytes, meaning]) => el("div", {}, el("dt", {}, bytes), el("dd", {}, meaning))))
      : el("p", {}, "none"));
  return el("div", { class: "frame-details" },
    frame.verdict === "done" && frame.outcome !== "done" ? el("p", { class: "why" }, el("b", {}, `${frame.text}: `), frame.outcome) : null,
    frame.verdict !== "done" && frame.reason ? el("p", { class: "why" }, el("b", {}, "Why: "), frame.reason) : null,
    list(frame.sent ? "Sent by the drive" : "Request", frame.bytes, frame.sent ?? false),
    frame.sent ? null : list("Answer", frame.answer, true));
}
