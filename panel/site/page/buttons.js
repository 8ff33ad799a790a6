// The card above a drive: buttons for the scripted master, what each does, and the message that came last.

import { attr, button, card, el, text } from "./dom.js";
import { clock } from "./format.js";
import { TRIES } from "./tries.js";

export function buttonsCard(app, drive, restart) {
  const kind = app.store.state.drive.kind;
  const tries = Object.entries(TRIES).find(([letters]) => kind.startsWith(letters))?.[1] ?? [];
  const losses = entry => entry.bus && app.store.state.buses?.[`${drive}.${entry.bus}`]?.faults.drop;

  const buttons = tries.map(entry => {
    const says = el("span", {}, entry.says);
    const node = button([el("b", {}, entry.title), says], { class: "try", "data-try": entry.name, "aria-pressed": entry.undo ? false : null }, async () => {
      for (const call of entry.undo && losses(entry) ? entry.undo : entry.calls) {
        const answer = await app.act(...call(drive));
        if (!answer.ok) return;
        if (answer.body?.ended) app.say(`The master leaves what it was doing, and begins with “${entry.title}”.`);
      }
    });
    return {
      node,
      /** Shows whether the line loses frames, which a second press ends. */
      update() {
        if (!entry.undo) return;
        attr(node, "aria-pressed", Boolean(losses(entry)));
        text(says, losses(entry) ? "The line loses frames until this button is pressed again. The traffic says which." : entry.says);
      },
    };
  });
  const last = el("p", { class: "last", role: "status" }, "Press a button: each message appears here, and in the traffic below.");
  const show = frame => {
    const said = frame.text || frame.outcome;
    const answer = frame.sent ? "sent by the drive itself" : frame.outcome;
    last.replaceChildren(el("code", {}, `${clock(frame.at)} s`), el("b", {}, said), el("span", { class: "answer" }, answer));
    const story = tries.find(({ end }) => end && `${said} ${answer}`.includes(end.text));
    if (story) last.append(el("span", { class: "means" }, story.end.means));
    attr(last, "data-verdict", frame.verdict);
  };
  const reset = button("Start again", { "data-action": "start-again", title: "The whole bench begins again, as it was at first" }, restart);
  const node = card("Try it", { class: "tries" }, el("div", { class: "tools" }, el("span", { class: "hint" }, "The drive runs in this page, as its manual says. A small master sends it the messages."), reset),
    el("div", { class: "try-list" }, buttons.map(button => button.node)), last);

  return {
    node,
    update({ traffic, changes, whole }) {
      if (whole || changes.buses) for (const button of buttons) button.update();
      const frame = traffic.at(-1);
      if (frame) show(frame);
    },
  };
}
