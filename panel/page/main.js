// The frame of the page: the connection to the bench, the route `#/NAME`, and one drawing per animation frame.

import { backend } from "./backend.js";
import { button, el, text } from "./dom.js";
import { downloads } from "./downloads.js";
import { driveView } from "./drive.js";
import { driveList } from "./drives.js";
import { Histories } from "./history.js";
import { overview } from "./overview.js";
import { Store } from "./state.js";
import { timeControl } from "./time.js";

const $ = id => document.getElementById(id);
const store = new Store();
const kinds = new Map();

const SLOW = 2000; // milliseconds that a call waits in silence
let slow = 0, slowNote = null; // calls that wait longer

/** Makes a call; one that waits long says so. */
async function call(method, path, body) {
  let isSlow = false;
  const late = setTimeout(() => {
    isSlow = true;
    if (slow++ === 0) slowNote = app.say("The bench has not answered for 2 s; the call still waits.", null);
  }, SLOW);
  const answer = await backend.call(method, path, body);
  clearTimeout(late);
  if (isSlow && --slow === 0) slowNote.remove();
  return answer;
}

/** What the views share. */
const app = {
  backend: { ...backend, call },
  store,
  histories: new Histories(),
  /** Numbers of messages to a drive that it refused, and that had no answer. */
  failures: name => {
    const { refused = 0, unanswered = 0 } = store.state.drives?.[name] ?? {};
    return { refused, unanswered };
  },
  /** The description of a kind, asked for once. */
  async kind(name) {
    if (!kinds.has(name)) {
      const answer = await call("GET", `kinds/${encodeURIComponent(name)}`);
      if (!answer.ok) return null;
      kinds.set(name, answer.body);
    }
    return kinds.get(name);
  },
  /** Makes a call, and shows the sentence of a refusal. */
  async act(method, path, body) {
    const answer = await call(method, path, body);
    if (!answer.ok) app.say(answer.body?.detail ?? `The bench refused the call (${answer.status}).`);
    return answer;
  },
  /** Shows a sentence for a while, or with `null` until its node is removed; gives the node. */
  say(sentence, milliseconds = 10_000) {
    const close = button("Close", { class: "ghost" }, () => note.remove());
    const note = el("div", { class: "notice" }, el("span", {}, sentence), close);
    const notices = $("notices");
    if (notices.childElementCount >= 3) notices.firstElementChild.remove();
    notices.append(note);
    if (milliseconds !== null) setTimeout(() => note.remove(), milliseconds);
    return note;
  },
  /** The reason why this bench cannot do something, by the names of the contract; undefined if it can. */
  cannot: (...names) => names.map(name => store.state.cannot?.[name]).find(reason => reason !== undefined),
};

const list = driveList(app, $("list"));
const time = timeControl(app, $("time"));
const downloadMenu = downloads(app, $("downloads"));

let view = null;
let shown; // name of the shown drive, null for the overview, undefined before the first route
let stop = () => {};
let frame = 0;
let opening = 0;
let missing = false; // the bench has no drive of this name
let firstVisit = location.hash === "";
backend.begin?.(app); // a site has more to show

function route() {
  const match = location.hash.match(/^#\/(.+)$/);
  let name = null;
  try {
    name = match ? decodeURIComponent(match[1]) : null;
  } catch {
    // A hand-made address that is no name shows the bench.
  }
  if (name === shown && !missing) return;
  shown = name;
  missing = false;
  view?.close();
  view = null;
  setList(false);
  clearTimeout(opening);
  opening = setTimeout(() => view || missing || $("content").replaceChildren(el("p", { class: "empty" }, "Connecting to the bench…")), 400);
  follow();
  list.choose(name);
}

/** Follows the shown drive, or the bench. A hidden page holds no connection: a browser has six for each host. */
function follow() {
  stop();
  stop = () => {};
  if (!document.hidden) stop = backend.follow(missing ? null : shown, onUpdate, onConnection);
}

function onUpdate(update, whole) {
  store.take(update, whole);
  app.histories.take(store.state, whole);
  // A board may become a drive of another kind.
  if (view && update.state?.drive?.kind && view.kind !== store.state.drive.kind) {
    view.close();
    view = null;
  }
  if (!view && !missing && (whole || update.state?.drive)) open();
  if (!frame) frame = requestAnimationFrame(draw);
}

/** Opens the view of the route, now that the bench's state is known. */
function open() {
  const names = Object.keys(store.state.drives ?? {});
  if (firstVisit && names.length === 1) {
    firstVisit = false;
    location.replace(`#/${encodeURIComponent(names[0])}`);
    return;
  }
  if (!firstVisit && document.activeElement !== document.body) $("content").focus({ preventScroll: true });
  firstVisit = false;
  if (shown !== null && !store.state.drive) return onConnection(`There is no drive '${shown}' on this bench`, true);
  view = shown === null ? overview(app) : driveView(app, shown);
  document.title = shown === null ? "drivetwin" : `${shown} · drivetwin`;
  $("content").replaceChildren(view.node);
  scrollTo(0, 0);
}

function draw() {
  frame = 0;
  const news = store.drain();
  list.update(news);
  time.update(news);
  downloadMenu.update(news);
  view?.update(news);
}

function onConnection(state, isFinal = false) {
  const lost = state !== true;
  if (lost && isFinal) {
    view?.close();
    view = null;
    $("content").replaceChildren(el("div", { class: "empty" }, el("h1", {}, "No such drive"), el("p", {}, `${state}.`), el("a", { href: "#/" }, "Show the bench")));
    text($("link"), "");
    missing = true;
    follow(); // the bench, for the list
    return;
  }
  document.documentElement.classList.toggle("lost", lost);
  $("time").inert = $("downloads").inert = lost; // nothing to set, and nothing to record
  $("link").className = lost ? "lost" : "";
  text($("link"), lost ? state : "");
}

function setList(open) {
  document.body.classList.toggle("list-open", open);
  $("list-toggle").setAttribute("aria-expanded", open);
}

$("list-toggle").addEventListener("click", () => {
  const opened = !document.body.classList.contains("list-open");
  setList(opened);
  if (opened) list.focus();
});

const THEMES = ["system", "light", "dark"];
function theme(choice) {
  if (choice === "system") {
    localStorage.removeItem("theme");
    delete document.documentElement.dataset.theme;
  } else {
    localStorage.setItem("theme", choice);
    document.documentElement.dataset.theme = choice;
  }
  const name = { system: "Auto", light: "Light", dark: "Dark" }[choice];
  text($("theme"), name);
  $("theme").setAttribute("aria-label", `${name} theme: change`);
  dispatchEvent(new Event("theme"));
}
let chosenTheme = document.documentElement.dataset.theme ?? "system";
theme(chosenTheme);
$("theme").addEventListener("click", () => {
  chosenTheme = THEMES[(THEMES.indexOf(chosenTheme) + 1) % THEMES.length];
  theme(chosenTheme);
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => dispatchEvent(new Event("theme")));

document.addEventListener("keydown", event => {
  if (event.key === "/" && !/^(INPUT|TEXTAREA|SELECT)$/.test(event.target.tagName)) {
    event.preventDefault();
    if (matchMedia("(max-width: 860px)").matches) setList(true);
    list.focus();
  }
});
document.addEventListener("visibilitychange", follow);
// Nor does a page that the browser keeps for its Back button.
addEventListener("pagehide", () => stop());
addEventListener("pageshow", event => event.persisted && follow());
addEventListener("hashchange", route);
route();
