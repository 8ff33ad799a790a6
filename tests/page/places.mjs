// The two places where a person meets a drive: the page of a process, and the static site.
//
// Both have an MD3 named `md3` with a page, a master on its line, and calls:
//
//   write(register, value)       by the master; resolves when the drive has answered
//   refused(register, value)     the same, and the drive must answer with exception 2
//   call(method, path, body)     of the control API

import assert from "node:assert/strict";

import { open, run } from "./bench.mjs";
import { masterOf } from "./md3.mjs";
import { serve } from "./server.mjs";

/** Registers of the MD3 User Guide, chapter 7; of Speed, the low word. */
const REGISTERS = { Reserved: 0x0b, MotionControl: 0x11, Speed: 0x15, EEPROMControl: 0x1a };

/** A process, and a foreign master: RTU frames over TCP. */
export const ofProcess = {
  name: "process",
  async begin({ manual = false } = {}) {
    const bench = await run("md3", "--listen", "tcp:127.0.0.1:0", "--fast-boot", ...(manual ? ["--time", "manual"] : []));
    const master = await masterOf(bench);
    const write = (register, value) => master.writeRegister(REGISTERS[register], value);
    return {
      address: `${bench.control}/`, write,
      refused: (register, value) => assert.rejects(write(register, value), { modbusCode: 2 }),
      call: (method, path, body) => bench.call(method, `api/${path}`, body),
      async prepare() {},
      async end() {
        master.close(() => {});
        await bench.stop();
      },
    };
  },
};

/** The site on a server of files, and its scripted master. */
const ofSite = {
  name: "site",
  async begin({ manual = false } = {}) {
    const files = await serve(process.env.SITE);
    let page = null;
    const call = async (method, path, body) => {
      const answer = await page.evaluate(async (...call) => (await import("./panel/backend.js")).backend.call(...call), method, path, body);
      if (!answer.ok) throw new Error(`${method} ${path}: ${answer.body.detail}`);
      return answer.body;
    };
    const write = async (register, value) => {
      await call("POST", "master", { drive: "md3", steps: [{ write: register, value }] });
      const isThere = words => [...document.querySelectorAll("[data-traffic]")].some(row => new RegExp(words).test(row.textContent));
      await page.waitForFunction(isThere, { timeout: 10_000 }, `write ${register}(Low)? = ${value}`);
    };
    return {
      address: files.address, write, refused: write, call,
      async prepare(opened) {
        page = opened;
        if (manual) await call("PUT", "time", { mode: "manual" });
      },
      async end() {
        files.close();
      },
    };
  },
};

/** The site is tested if the variable SITE says where it is. */
export const PLACES = process.env.SITE ? [ofProcess, ofSite] : [ofProcess];

/** Runs a test with an MD3, its page and a master. */
export async function withMd3(browser, place, act, options) {
  const bench = await place.begin(options);
  const { page, faults } = await open(browser, `${bench.address}#/md3`);
  try {
    await page.waitForSelector("[data-drive=md3]");
    await bench.prepare(page);
    await act({ bench, page });
    assert.deepEqual(faults, []);
  } finally {
    await page.close();
    await bench.end();
  }
}
