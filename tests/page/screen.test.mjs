// The terminal of the pictures.

import assert from "node:assert/strict";
import { test } from "node:test";

import { Screen } from "./screen.mjs";

const textOf = screen => screen.cells.map(row => row.map(cell => cell.text).join("").trimEnd()).join("\n").trimEnd();

test("words that come in two parts are those that come at once", () => {
  const words = "\x1b[?1049h\x1b[2J\x1b[1;3Hhigh\x1b[1;8H\x1b[38;5;6;49minput\x1b[0m";
  for (let at = 0; at <= words.length; at++) {
    const screen = new Screen();
    screen.take(words.slice(0, at));
    screen.take(words.slice(at));
    assert.equal(textOf(screen), "  high input", `divided at ${at}`);
    assert.equal(screen.cells[0][7].style.ink, "#4fd3e0");
  }
});
