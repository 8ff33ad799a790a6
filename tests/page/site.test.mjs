// What only the static site has: its buttons, its clock, and no server.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { browser as startBrowser, click, open, sees, textOf } from "./bench.mjs";
import { serve } from "./server.mjs";

const skip = process.env.SITE ? false : "SITE does not say where the site is";

let browser, files;
before(async () => {
  if (skip) return;
  [browser, files] = await Promise.all([startBrowser(), serve(process.env.SITE)]);
});
after(async () => {
  await browser?.close();
  files?.close();
});

function onSite(name, act, hash = "") {
  test(name, { skip }, async () => {
    const { page, faults } = await open(browser, `${files.address}${hash}`);
    try {
      await page.waitForSelector("[data-try]", { timeout: 20_000 });
      await act(page);
      assert.deepEqual(faults, []);
    } finally {
      await page.close();
    }
  });
}

/** Lets the bench run ten times as fast as the browser's clock, or as fast as it can. */
const hurry = page => click(page, "[data-action=time-faster]");

/** Waits for a message in the traffic. */
async function hears(page, words, timeout = 20_000) {
  const isThere = words => [...document.querySelectorAll("[data-traffic]")].some(row => row.textContent.includes(words));
  await page.waitForFunction(isThere, { timeout }, words).catch(() => assert.fail(`the traffic has no “${words}”`));
}

onSite("a button moves the motor, and another one takes it home", async page => {
  // The first view is a drive that can be pressed: the MD3.
  assert.match(page.url(), /#\/md3$/);
  await sees(page, "[data-motion=position]", "data-value", 0);
  await hurry(page);
  await click(page, "[data-try=move]");
  await sees(page, "[data-motion=position]", "data-value", 10_000);
  await hears(page, "write MotionControl = 1");
  assert.match(await textOf(page, ".last"), /write MotionControl = 1/);
  // The switch is half a turn behind the start: 800 of 1,600 microsteps.
  await click(page, "[data-try=home]");
  await sees(page, "[data-motion=position]", "data-value", -800);
});

onSite("a master repeats what the line loses, until the button is pressed again", async page => {
  await click(page, "[data-try=lose]");
  await sees(page, "[data-try=lose]", "aria-pressed", true);
  assert.match(await textOf(page, "[data-try=lose]"), /until this button is pressed again/);
  await hears(page, "dropped");
  await click(page, "[data-try=lose]");
  await sees(page, "[data-try=lose]", "aria-pressed", false);
  assert.match(await textOf(page, "[data-try=lose]"), /chance of one in three, until a second press/);
});

onSite("a power cut in a save spoils the memory, and the master reads so", async page => {
  await click(page, "[data-try=cut]");
  await sees(page, "[data-action=power-off]", "aria-pressed", true);
  await sees(page, "[data-action=power-on]", "aria-pressed", true);
  await hurry(page);
  // No press vanishes: the master says for how long it waits, and neither writes nor cuts the power again.
  for (const name of ["refuse", "cut"]) await click(page, `[data-try=${name}]`);
  await page.waitForFunction(() => document.querySelectorAll(".notice").length === 2);
  assert.match(await textOf(page, "#notices"), /the master waits for the drive: \d+ s/);
  // 7.20: 0xF1 in the high byte is a failed check.
  await hears(page, `EEPROMControl = ${0xf100}`);
  assert.match(await textOf(page, ".last"), /the memory is spoiled/);
  assert.equal(await page.$$eval("[data-traffic]", rows => rows.filter(row => /UserRegister|Reserved/.test(row.textContent)).length), 1);
});

onSite("a press ends what the master was doing, and says so", async page => {
  await click(page, "[data-try=lose]");
  await sees(page, "[data-try=lose]", "aria-pressed", true);
  await click(page, "[data-try=refuse]");
  await page.waitForFunction(() => /leaves what it was doing, and begins with “Write where nobody may”/.test(document.querySelector("#notices").textContent));
});

onSite("a refused write says why", async page => {
  await click(page, "[data-try=refuse]");
  await hears(page, "0x000B Reserved is read only");
  assert.equal(await page.$eval(".last", node => node.dataset.verdict), "refused");
});

test("a bench that cannot be loaded says so, and nothing else", { skip }, async () => {
  const page = await browser.newPage();
  try {
    await page.setRequestInterception(true);
    page.on("request", request => request.url().endsWith(".wasm") ? request.abort() : request.continue());
    await page.goto(files.address);
    await page.waitForFunction(() => /could not be loaded .* reload the page/.test(document.querySelector("#link").textContent));
    // The page writes that it connects after a moment, too.
    await page.waitForFunction(() => document.querySelector("#content > .empty") && performance.now() > 1000);
    const content = await page.$eval("#content", node => ({ shown: node.innerText.trim(), sentence: getComputedStyle(node, "::before").content }));
    assert.equal(content.shown, "");
    assert.match(content.sentence, /could not be loaded .* reload the page/);
  } finally {
    await page.close();
  }
});

onSite("the bench begins again", async page => {
  await hurry(page);
  await click(page, "[data-try=move]");
  await sees(page, "[data-motion=position]", "data-value", 10_000);
  await click(page, "[data-action=start-again]");
  await sees(page, "[data-motion=position]", "data-value", 0);
  assert.equal(await page.$("[data-traffic]"), null);
});

for (const [drive, act, words] of [
  ["qsb", "stream", "stream ReadEncoder"], ["rs434", "run", "write MODE_USER_PROGRAM = 2"], ["mdrobot", "run", "write START_STOP = 1"], ["mdrive", "move", "write MR = 51200"],
]) {
  onSite(`a button of ${drive} is a message in its traffic`, async page => {
    await click(page, `[data-drive=${drive}] [data-try=${act}]`);
    await hears(page, words);
  }, `#/${drive}`);
}

onSite("a person types MCode", async page => {
  await click(page, "[data-try=move]");
  await sees(page, "[data-motion=position]", "data-value", 51_200);
  await click(page, "[data-action=terminal]");
  const input = await page.waitForSelector(".prompt input:not(:disabled)");
  await input.type("PR P");
  await input.press("Enter");
  await page.waitForFunction(() => /51200/.test(document.querySelector(".terminal pre").textContent), { timeout: 10_000 });
}, "#/mdrive");

onSite("a page that was hung does not make up for it", async page => {
  const time = () => page.$eval("[data-time]", node => Number(node.getAttribute("data-value")));
  // Three seconds of nothing but this; then two frames, which make up for a quarter of a second each at most.
  const [before, after] = await page.evaluate(async () => {
    const time = () => Number(document.querySelector("[data-time]").getAttribute("data-value"));
    const before = time(), end = performance.now() + 3000;
    while (performance.now() < end);
    for (let frames = 0; frames < 3; frames++) await new Promise(requestAnimationFrame);
    return [before, time()];
  });
  assert.ok(after - before < 1.5, `${after - before} s have passed`);
  await page.waitForFunction(after => Number(document.querySelector("[data-time]").getAttribute("data-value")) > after, {}, await time());
});
