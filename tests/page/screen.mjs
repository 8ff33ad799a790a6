// The terminal view as a picture: a pty's bytes become cells, and the browser draws them.

import { spawn } from "node:child_process";

import { DRIVETWIN, run } from "./bench.mjs";
import { masterOf } from "./md3.mjs";

const COLUMNS = 120, ROWS = 36;

/** The 16 colours of a terminal, and of its ground. */
const COLOURS = ["#0c0e10", "#ff8a80", "#5fd08f", "#f0bb5a", "#7ea6ff", "#d6a2e8", "#4fd3e0", "#c0c6cc", "#6b737b", "#ff8a80", "#5fd08f", "#ffd58a", "#a9c4ff", "#e6c2f2", "#8fe6ee", "#ffffff"];
const [GROUND, INK] = ["#14171a", "#d7dbdf"];

/** Colour of a number of 256. */
function colourOf(number) {
  if (number < 16) return COLOURS[number];
  if (number >= 232) return `rgb(${Array(3).fill(8 + 10 * (number - 232)).join()})`;
  const level = part => (part ? 55 + 40 * part : 0), n = number - 16;
  return `rgb(${[level(Math.floor(n / 36)), level(Math.floor(n / 6) % 6), level(n % 6)].join()})`;
}

/** A screen that understands what the view writes: places, styles, text, and clearing. */
export class Screen {
  cells = Array.from({ length: ROWS }, () => Array.from({ length: COLUMNS }, () => ({ text: " ", style: {} })));
  style = {};
  row = 0;
  column = 0;
  rest = "";

  /** Takes words in. A sequence whose end is still to come waits for it: a pty divides words anywhere. */
  take(more) {
    const all = this.rest + more, end = all.search(/\x1b(\[[?>0-9;]*)?$/);
    const words = end < 0 ? all : all.slice(0, end);
    this.rest = all.slice(words.length);
    for (const [, csi, end, , character] of words.matchAll(/\x1b\[([?>0-9;]*)([A-Za-z])|(\x1b[^[])|([^])/gu)) {
      if (end === "H") [this.row, this.column] = [0, 1].map(at => (Number(csi.split(";")[at]) || 1) - 1);
      else if (end === "J") for (const row of this.cells) row.fill({ text: " ", style: {} });
      else if (end === "m") this.paint((csi || "0").split(";").map(Number));
      else if (character && character >= " " && this.row < ROWS && this.column < COLUMNS) this.cells[this.row][this.column++] = { text: character, style: this.style };
      else if (character === "\r") this.column = 0;
      else if (character === "\n") this.row++;
    }
  }

  paint(codes) {
    while (codes.length) {
      const code = codes.shift();
      if (code === 0) this.style = {};
      else if (code === 38 || code === 48) {
        const isPlain = codes.shift() === 5, colour = isPlain ? colourOf(codes.shift()) : `rgb(${codes.splice(0, 3).join()})`;
        this.style = { ...this.style, [code === 38 ? "ink" : "ground"]: colour };
      } else if (code === 1 || code === 2 || code === 7) this.style = { ...this.style, [{ 1: "bold", 2: "dim", 7: "swapped" }[code]]: true };
      else if (code === 22) this.style = { ...this.style, bold: false, dim: false };
      else if (code === 27) this.style = { ...this.style, swapped: false };
      else if (code === 39) this.style = { ...this.style, ink: undefined };
      else if (code === 49) this.style = { ...this.style, ground: undefined };
      else if (code >= 30 && code < 38) this.style = { ...this.style, ink: COLOURS[code - 30] };
      else if (code >= 90 && code < 98) this.style = { ...this.style, ink: COLOURS[code - 82] };
      else if (code >= 40 && code < 48) this.style = { ...this.style, ground: COLOURS[code - 40] };
    }
  }

  html() {
    const cell = ({ text, style: { ink = INK, ground = GROUND, bold, dim, swapped } }) => {
      const [front, back] = swapped ? [ground, ink] : [ink, ground];
      return `<span style="display:inline-block;width:9px;color:${front};background:${back};font-weight:${bold ? 700 : 400};opacity:${dim ? 0.6 : 1}">${text.replace(/[<&]/g, mark => `&#${mark.charCodeAt(0)};`)}</span>`;
    };
    return `<pre style="margin:0;padding:18px 20px;background:${GROUND};width:max-content;font:15px/19px 'DejaVu Sans Mono',monospace">${this.cells.map(row => row.map(cell).join("")).join("\n")}</pre>`;
  }
}

/** A picture of the view of an MD3 that moves, after a refused write. */
export async function terminal(browser) {
  const bench = await run("md3", "--listen", "tcp:127.0.0.1:0", "--fast-boot");
  const command = `stty cols ${COLUMNS} rows ${ROWS}; exec ${DRIVETWIN} view ${bench.control}`;
  const child = spawn("script", ["-qefc", command, "/dev/null"], { stdio: ["pipe", "pipe", "inherit"], env: { ...process.env, TERM: "xterm-256color" } });
  const screen = new Screen(), decoder = new TextDecoder();
  child.stdout.on("data", bytes => screen.take(decoder.decode(bytes, { stream: true })));
  const master = await masterOf(bench);
  await master.writeRegister(0x0b, 5).catch(() => {}); // Reserved
  await master.writeRegister(0x11, 1); // MotionControl: Move
  await new Promise(resolve => setTimeout(resolve, 1800));
  const page = await browser.newPage();
  await page.setContent(screen.html());
  const picture = await (await page.$("pre")).screenshot();
  await page.close();
  child.stdin.write("q");
  master.close(() => {});
  await bench.stop();
  return picture;
}
