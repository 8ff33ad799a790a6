// A person looks for why a master gets no answer, or is refused; what the page says of it in a real Chromium.

import assert from "node:assert/strict";
import { mkdtempSync, readFileSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";

import { browser as startBrowser, click, open, run, sees, textOf } from "./bench.mjs";
import { masterOf, runMd3 } from "./md3.mjs";

// Registers of the MD3 User Guide, chapter 7.
const DEVICE_ADDRESS = 0x00, RESERVED = 0x0b, MOTION_CONTROL = 0x11, SPEED_LOW = 0x15, LAST = 0x1f;

let browser;
before(async () => { browser = await startBrowser(); });
after(() => browser.close());
const withMd3 = (act, ...options) => runMd3(browser, act, ["--fast-boot", ...options]);

/** Types a value into the field of a register. */
async function edit(page, register, value) {
  const input = await page.waitForSelector(`input[data-edit=${register}]`);
  await input.scrollIntoView();
  await input.click({ count: 3 });
  await input.type(value);
  await input.press("Enter");
}

test("requests without an answer are under the filter of the refused ones", () => withMd3(async ({ master, page }) => {
  await sees(page, "[data-motion=position]", "data-value", 0);
  // Nobody has address 9.
  master.setID(9);
  master.setTimeout(300);
  await assert.rejects(master.writeRegister(MOTION_CONTROL, 1));
  await sees(page, "[data-listed=md3] [data-failures=unanswered]", "data-value", 1);
  master.setID(1);
  master.setTimeout(2000);
  await master.writeRegister(SPEED_LOW, 9);
  await assert.rejects(master.writeRegister(RESERVED, 5), { modbusCode: 2 });
  await sees(page, "[data-listed=md3] [data-failures=refused]", "data-value", 1);
  assert.equal(await textOf(page, "#traffic [data-filter=refused]"), "Refused or unanswered 2");
  await click(page, "#traffic [data-filter=refused]");
  const rows = await page.$$eval("[data-traffic] .said", nodes => nodes.map(node => node.textContent));
  assert.deepEqual(rows, ["write MotionControl = 1", "write Reserved = 5"]);
}));

test("requests during the start-up are under the filter of the refused ones", () => runMd3(browser, async ({ bench, master, page }) => {
  // MD3: it answers 2.5 s after power-on. In manual time it is starting still.
  await sees(page, "[data-motion=position]", "data-value", 0);
  master.setTimeout(300);
  await assert.rejects(master.writeRegister(MOTION_CONTROL, 1));
  await bench.call("POST", "api/time/advance", { seconds: 1 });
  await sees(page, "[data-listed=md3] [data-failures=unanswered]", "data-value", 1);
  await click(page, "#traffic [data-filter=refused]");
  assert.match(await textOf(page, "[data-traffic]"), /write MotionControl = 1.*starting/);
}, ["--time", "manual"]));

test("a coil does not read as a register, and a missing function is no fault of a register", () => withMd3(async ({ master, page }) => {
  await sees(page, "[data-motion=position]", "data-value", 0);
  // The MD3 has no coils.
  await assert.rejects(master.writeCoil(DEVICE_ADDRESS, true), { modbusCode: 1 });
  const row = await textOf(page, "[data-traffic][data-verdict=refused]");
  assert.match(row, /write coil 0x0000 = on/);
  assert.match(row, /the drive has no function 5/);
  assert.equal(await page.$("[data-register].has-refusal"), null);
  // The row has said why.
  await click(page, "[data-traffic][data-verdict=refused] button");
  await page.waitForSelector(".frame-details");
  assert.equal(await page.$(".frame-details .why"), null);
}));

test("a refused message that is opened keeps its place", () => withMd3(async ({ master, page }) => {
  await sees(page, "[data-motion=position]", "data-value", 0);
  await assert.rejects(master.writeRegister(RESERVED, 5), { modbusCode: 2 });
  for (let speed = 1; speed <= 20; speed++) await master.writeRegister(SPEED_LOW, speed);
  await page.waitForSelector("[data-traffic='21']");
  const row = "[data-traffic][data-verdict=refused]";
  const place = () => page.$eval(row, node => node.getBoundingClientRect().top - node.closest(".frames-scroll").getBoundingClientRect().top);
  await page.$eval(row, node => (node.closest(".frames-scroll").scrollTop = node.offsetTop - node.closest(".frames-scroll").scrollHeight));
  const before = await place();
  await page.click(`${row} button`);
  await page.waitForSelector(".frame-details");
  assert.ok(Math.abs(await place() - before) <= 1, `it was at ${before} px and is at ${await place()} px`);
  await page.click(`${row} button`);
  assert.ok(Math.abs(await place() - before) <= 1);
}));

test("an address without a register is also shown in decimal, with a hint if it is one off", () => withMd3(async ({ master, page }) => {
  await sees(page, "[data-motion=position]", "data-value", 0);
  // MD3 chapter 7: the last register is 0x1F.
  for (const [number, address, hint] of [[1, 99, false], [2, LAST + 1, true]]) {
    await assert.rejects(master.readHoldingRegisters(address, 1), { modbusCode: 2 });
    await click(page, `[data-traffic='${number}'] button`);
    const said = await textOf(page, `[data-traffic='${number}'] .frame-details`);
    assert.ok(said.includes(`register 0x00${address.toString(16)} (${address})`), said);
    assert.equal(/Is it one off\? There is a register at 0x001F \(31\)/.test(said), hint, said);
  }
}));

test("the note of a refusal goes when the register is written, or when it is closed", () => withMd3(async ({ master, page }) => {
  await sees(page, "[data-register=DeviceAddress]", "data-value", 1);
  const refuse = async () => {
    await assert.rejects(master.writeRegister(DEVICE_ADDRESS, 248));
    const note = await textOf(page, "[data-register=DeviceAddress].has-refusal .refusal");
    assert.match(note, /^Refused at [\d.]+ s: write DeviceAddress = 248: 0x0000 DeviceAddress = 248 is not allowed, it takes 1 to 247/);
  };
  await refuse();
  await click(page, "[data-register=DeviceAddress] .refusal button");
  assert.equal(await page.$(".has-refusal"), null);
  await refuse();
  await master.writeRegister(DEVICE_ADDRESS, 1);
  await page.waitForSelector("[data-register=DeviceAddress]:not(.has-refusal)");
}));

test("a drive without power has no known values", () => withMd3(async ({ page }) => {
  await sees(page, "[data-register=Speed]", "data-value", 5000);
  await click(page, "[data-action=power-off]");
  await page.waitForSelector("[data-register=Speed]:not([data-value])");
  assert.equal(await page.$eval("input[data-edit=Speed]", input => input.value), "");
  await click(page, "[data-action=power-on]");
  await sees(page, "[data-register=Speed]", "data-value", 5000);
}));

test("a refusal for lack of power goes when the power is back", () => withMd3(async ({ page }) => {
  await sees(page, "[data-register=Speed]", "data-value", 5000);
  await click(page, "[data-action=power-off]");
  await page.waitForSelector("[data-register=Speed]:not([data-value])");
  await edit(page, "Speed", "8000");
  await sees(page, "[data-register=Speed]", "data-error", "md3 has no power");
  await click(page, "[data-action=power-on]");
  await page.waitForSelector("[data-register=Speed]:not([data-error])");
}));

test("commas between thousands are left out, and a list is no number", () => withMd3(async ({ page }) => {
  await sees(page, "[data-register=Speed]", "data-value", 5000);
  await edit(page, "Speed", "10,000");
  await sees(page, "[data-register=Speed]", "data-value", 10_000);
  await edit(page, "Speed", "1, 2");
  await sees(page, "[data-register=Speed]", "data-error", "Speed takes one number, not 2");
  await sees(page, "[data-register=Speed]", "data-value", 10_000);
}));

test("a number that is typed after Enter begins anew", () => withMd3(async ({ page }) => {
  await sees(page, "[data-register=Speed]", "data-value", 5000);
  await edit(page, "Speed", "8000");
  await sees(page, "[data-register=Speed]", "data-value", 8000);
  await page.keyboard.type("7000");
  await page.keyboard.press("Enter");
  await sees(page, "[data-register=Speed]", "data-value", 7000);
  // Nor does it matter whether the bench has answered.
  await page.keyboard.type("6000");
  await page.keyboard.press("Enter");
  await page.keyboard.type("9000");
  await page.keyboard.press("Enter");
  await sees(page, "[data-register=Speed]", "data-value", 9000);
}));

test("a register is found by its address with and without leading zeros", () => withMd3(async ({ page }) => {
  await sees(page, "[data-register=Speed]", "data-value", 5000);
  for (const words of ["0x11", "0x0011", "17"]) {
    await page.$eval("#registers input[type=search]", (input, words) => {
      input.value = words;
      input.dispatchEvent(new Event("input"));
    }, words);
    assert.equal(await page.$("[data-register=MotionControl][hidden]"), null, words);
    assert.notEqual(await page.$("[data-register=DeviceAddress][hidden]"), null, words);
  }
}));

test("a number that a field cannot take is answered at the field", () => withMd3(async ({ page }) => {
  await sees(page, "[data-time]", "data-state", "manual");
  const type = async (selector, words, key = "Enter") => {
    const input = await page.waitForSelector(selector);
    await input.scrollIntoView();
    await input.click({ count: 3 });
    await input.press("Backspace");
    await input.type(words);
    await input.press(key);
  };
  const note = selector => textOf(page, `${selector} + .field-note`);
  const factor = "[aria-label='Times faster than real time']", seconds = "[aria-label='Seconds to advance']", code = "[aria-label='Exception: code']";
  for (const words of ["2.5", "0", "1001"]) {
    await type(factor, words);
    assert.equal(await note(factor), "The factor takes a whole number from 1 to 1000.", words);
  }
  await sees(page, "[data-time]", "data-state", "manual");
  await type(seconds, "");
  assert.equal(await note(seconds), "Advance takes a number from 0 to 86400.");
  await sees(page, "[data-time]", "data-value", 0);
  for (const words of ["0", "256", "-1"]) {
    await type(code, words);
    assert.equal(await note(code), "Exception takes a whole number from 1 to 255.", words);
  }
  await type(code, "6");
  await page.waitForFunction(code => !document.querySelector(`${code} + .field-note`), {}, code);
}, "--time", "manual"));

test("a field shows again what the drive has when its value is refused", async () => {
  const bench = await run("mdrive", "--fast-boot");
  const { page, faults } = await open(browser, `${bench.control}/#/mdrive`);
  try {
    // MCode manual, CE: 2 is for MCode alone.
    await sees(page, "[data-register=CE]", "data-value", 1);
    await click(page, "[data-register=CE] .register-name");
    const field = "[data-register=CE] .fields select";
    await page.waitForSelector(field);
    await page.select(field, "2");
    await page.waitForSelector("[data-register=CE][data-error]");
    assert.match(await page.$eval("[data-register=CE]", node => node.dataset.error), /^CE takes /);
    assert.equal(await page.$eval(field, select => select.value), "1");
    assert.deepEqual(faults, []);
  } finally {
    await page.close();
    await bench.stop();
  }
});

test("a list shows the failures of drives that are not open", async () => {
  const folder = mkdtempSync(join(tmpdir(), "drivetwin-page-"));
  const file = join(folder, "bench.toml");
  writeFileSync(file, '[[drive]]\nname = "a"\nkind = "md3"\nfast_boot = true\nlisten = ["tcp:127.0.0.1:0"]\n[[drive]]\nname = "b"\nkind = "md3"\n');
  const bench = await run(file);
  const { page, faults } = await open(browser, `${bench.control}/#/b`);
  const master = await masterOf(bench);
  try {
    await page.waitForSelector("[data-drive=b]");
    await assert.rejects(master.writeRegister(RESERVED, 5), { modbusCode: 2 });
    await sees(page, "[data-listed=a] [data-failures=refused]", "data-value", 1);
    await sees(page, "[data-listed=b] [data-failures=refused]", "data-value", 0);
    assert.deepEqual(faults, []);
  } finally {
    await page.close();
    master.close(() => {});
    await bench.stop();
  }
});

test("a part of the recording is marked and saved alone", () => withMd3(async ({ bench, page }) => {
  await sees(page, "[data-time]", "data-value", 0);
  await bench.call("POST", "api/time/advance", { seconds: 2 });
  await page.waitForFunction(() => document.querySelector("[data-time]").dataset.value >= 2);
  await click(page, "[data-action=record]");
  await sees(page, "[data-action=record]", "data-state", "on");
  await bench.call("PUT", "api/drives/md3/pins/J2.2", { level: "low" });
  await bench.call("POST", "api/time/advance", { seconds: 1 });
  await page.waitForFunction(() => Math.abs(document.querySelector("[data-action=record]").dataset.value - 1) < 1e-3);
  await click(page, "[data-action=record]");
  await sees(page, "[data-action=record]", "data-state", "done");
  await bench.call("PUT", "api/drives/md3/pins/J2.3", { level: "low" });
  await bench.call("POST", "api/time/advance", { seconds: 1 });
  const folder = mkdtempSync(join(tmpdir(), "drivetwin-page-"));
  const client = await page.createCDPSession();
  await client.send("Browser.setDownloadBehavior", { behavior: "allow", downloadPath: folder, eventsEnabled: true });
  const done = new Promise(resolve => client.on("Browser.downloadProgress", ({ state }) => state === "completed" && resolve()));
  await click(page, "[data-download=vcd]");
  await done;
  const vcd = readFileSync(join(folder, "drivetwin.vcd"), "utf8");
  const times = vcd.match(/^#\d+$/gm).map(line => Number(line.slice(1)) / 1e9);
  // A call acts at the end of a tick, so the part begins and ends a few of them later.
  assert.ok(Math.abs(times[0] - 2) < 1e-5 && Math.abs(times.at(-1) - 3) < 1e-5, `${times}`);
  assert.ok(vcd.includes("$dumpvars"));
}, "--time", "manual"));

test("frames outside the marked part are cut out", () => withMd3(async ({ page }) => {
  const types = await page.evaluate(async () => {
    const { cutPcapng } = await import("/panel/recording.js");
    // A block of each type: its type, its length, interface, time in two halves, its length again.
    const block = (type, seconds) => {
      const view = new DataView(new ArrayBuffer(24));
      const nanos = seconds * 1e9;
      [type, 24, 0, Math.floor(nanos / 2 ** 32), nanos % 2 ** 32, 24].forEach((word, i) => view.setUint32(4 * i, word, true));
      return new Uint8Array(view.buffer);
    };
    const file = new Uint8Array([...block(0x0a0d0d0a, 0), ...block(1, 0), ...block(6, 1), ...block(6, 5), ...block(6, 9)]).buffer;
    return cutPcapng(file, 4e9, 6e9).map(bytes => {
      const view = new DataView(bytes);
      return [view.getUint32(0, true), view.getUint32(12, true) * 2 ** 32 + view.getUint32(16, true)];
    });
  });
  // The packet at 5 s is the only one of type 6.
  assert.deepEqual(types, [[0x0a0d0d0a, 0], [1, 0], [6, 5e9]]);
}));

for (const width of [390, 1280, 1440]) {
  test(`values of registers stand below each other, ${width} px`, async () => {
    const bench = await run("md3", "--fast-boot");
    const { page } = await open(browser, `${bench.control}/#/md3`, { width });
    try {
      await page.waitForSelector("[data-register]");
      const ends = await page.$$eval("input[data-edit]", nodes => nodes.slice(0, 40).map(node => Math.round(node.getBoundingClientRect().right)));
      assert.equal(new Set(ends).size, 1, `${ends}`);
    } finally {
      await page.close();
      await bench.stop();
    }
  });
}

for (const kind of ["md3", "qsb-d", "rs434544", "mdrobot", "mdrive"]) {
  test(`the first registers of ${kind} are seen without scrolling`, async () => {
    const bench = await run(kind, "--fast-boot");
    const { page } = await open(browser, `${bench.control}/#/${kind}`, { width: 1280, height: 900 });
    try {
      await page.waitForSelector("[data-register]");
      const bottom = await page.$$eval("[data-register]", nodes => nodes[1].getBoundingClientRect().bottom);
      assert.ok(bottom <= 900, `the second register ends at ${bottom} px`);
    } finally {
      await page.close();
      await bench.stop();
    }
  });
}

test("a name of 200 characters stays within the page", async () => {
  const folder = mkdtempSync(join(tmpdir(), "drivetwin-page-"));
  const file = join(folder, "bench.toml"), name = "x".repeat(200);
  writeFileSync(file, `[[drive]]\nname = "${name}"\nkind = "md3"\nlisten = ["tcp:127.0.0.1:0"]\n[[drive]]\nname = "b"\nkind = "md3"\n`);
  const bench = await run(file);
  try {
    for (const width of [1280, 390]) {
      for (const [route, selector] of [["#/", ".box"], [`#/${name}`, "[data-register]"]]) {
        const { page } = await open(browser, `${bench.control}/${route}`, { width });
        await page.waitForSelector(selector);
        const over = await page.evaluate(() => {
          const parents = [document.documentElement, ...document.querySelectorAll(".card-head, .line-info, nav, .drive-head")];
          return parents.map(node => node.scrollWidth - node.clientWidth).filter(pixels => pixels > 0);
        });
        assert.deepEqual(over, [], `${route.slice(0, 4)} at ${width} px`);
        await page.close();
      }
    }
  } finally {
    await bench.stop();
  }
});
