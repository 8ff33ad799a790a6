// An MD3 with its page and a foreign master, for tests.

import assert from "node:assert/strict";

import ModbusRTU from "modbus-serial";

import { open, run } from "./bench.mjs";

/** A foreign master on the line of a drive: RTU frames over TCP. */
export async function masterOf(bench) {
  const master = new ModbusRTU();
  await master.connectTelnet("127.0.0.1", { port: bench.port });
  master.setID(1);
  master.setTimeout(2000);
  return master;
}

/** Runs a test with an MD3, its page and a master. */
export async function runMd3(browser, act, options) {
  const bench = await run("md3", "--listen", "tcp:127.0.0.1:0", ...options);
  const master = await masterOf(bench);
  const { page, faults } = await open(browser, `${bench.control}/#/md3`);
  try {
    await act({ bench, master, page });
    assert.deepEqual(faults, []);
  } finally {
    await page.close();
    master.close(() => {});
    await bench.stop();
  }
}
