// The panel in a real Chromium, used as a person would: that of a process, and that of the static site.

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, readdirSync, readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";

import { browser as startBrowser, click, DRIVETWIN, open, run, sees, textOf } from "./bench.mjs";
import { PLACES, withMd3 } from "./places.mjs";

let browser;
before(async () => { browser = await startBrowser(); });
after(() => browser.close());

/** A test at each place. */
function atEach(name, act, options) {
  for (const place of PLACES) test(`${place.name}: ${name}`, () => withMd3(browser, place, act, options));
}

atEach("the page shows the lights and the motion of a drive that a master moves", async ({ bench, page }) => {
  // 7.20: D6 is the green light of the power; nothing moves yet.
  await sees(page, "[data-drive=md3] [data-led=D6]", "data-state", "on");
  await sees(page, "[data-motion=position]", "data-value", 0);
  const angle = () => page.$eval("[data-motion=position]", node => node.getAttribute("data-value"));
  assert.equal(await angle(), "0");
  // 10,000 steps at 5,000 per second.
  await bench.write("MotionControl", 1);
  await sees(page, "[data-motion=moving]", "data-state", "moving");
  await sees(page, "[data-motion=position]", "data-value", 10_000);
  assert.match(await textOf(page, "[data-traffic][data-verdict=done]"), /write MotionControl = 1/);
});

atEach("a refused write is seen where it happened", async ({ bench, page }) => {
  await sees(page, "[data-motion=position]", "data-value", 0);
  // 7.10: the register is reserved.
  await bench.refused("Reserved", 5);
  const row = await textOf(page, "[data-traffic][data-verdict=refused]");
  assert.match(row, /write Reserved = 5/);
  assert.match(row, /0x000B Reserved is read only/);
});

atEach("a limit switch is pressed and let go", async ({ bench, page }) => {
  await sees(page, "[data-pin='J2.2']", "data-state", "high");
  await click(page, "[data-pin='J2.2'] [data-set=low]");
  await sees(page, "[data-pin='J2.2']", "data-state", "low");
  assert.equal((await bench.call("GET", "drives/md3")).pins["J2.2"], "low");
  await click(page, "[data-pin='J2.2'] [data-set=open]");
  await sees(page, "[data-pin='J2.2']", "data-state", "high");
  // Nothing drives the pin: its pull-up gives the level.
  assert.equal(await textOf(page, "[data-pin='J2.2'] .level"), "high");
  await sees(page, "[data-pin='J2.2'] [data-set=open]", "aria-pressed", true);
  await sees(page, "[data-pin='J2.2'] [data-set=high]", "aria-pressed", false);
});

atEach("a wrong value is refused with the sentence of the table", async ({ bench, page }) => {
  const edit = async value => {
    const input = await page.waitForSelector("input[data-edit=DeviceAddress]");
    await input.scrollIntoView();
    await input.click({ count: 3 });
    await input.type(`${value}`);
    await input.press("Enter");
  };
  await sees(page, "[data-register=DeviceAddress]", "data-value", 1);
  // 7.1: 1 to 247.
  await edit(248);
  await page.waitForSelector("[data-register=DeviceAddress][data-error], [data-register=DeviceAddress] [data-error]");
  const sentence = await page.$eval("[data-register=DeviceAddress]", node => (node.matches("[data-error]") ? node : node.querySelector("[data-error]")).getAttribute("data-error"));
  assert.match(sentence, /^DeviceAddress takes 1 to 247, not 248$/);
  assert.equal((await bench.call("GET", "drives/md3")).registers.DeviceAddress, 1);
  await edit(7);
  await sees(page, "[data-register=DeviceAddress]", "data-value", 7);
  assert.equal((await bench.call("GET", "drives/md3")).registers.DeviceAddress, 7);
});

atEach("the power fails in the middle of a save", async ({ bench, page }) => {
  await sees(page, "[data-motion=position]", "data-value", 0);
  await sees(page, "[data-action=power-cut]", "aria-pressed", false);
  await click(page, "[data-action=power-cut]");
  await sees(page, "[data-action=power-cut]", "aria-pressed", true);
  // Off and on leave it armed.
  await click(page, "[data-action=power-off]");
  await sees(page, "[data-action=power-off]", "aria-pressed", true);
  await click(page, "[data-action=power-on]");
  await sees(page, "[data-action=power-on]", "aria-pressed", true);
  await sees(page, "[data-action=power-cut]", "aria-pressed", true);
  // 7.20: bit 0 saves all registers. A drive of the site starts for 2.5 s first, and has no request meanwhile.
  const isOff = () => page.$eval("[data-action=power-off]", node => node.ariaPressed === "true");
  for (let tries = 0; tries < 100 && !(await isOff()); tries++) {
    await bench.write("EEPROMControl", 1).catch(() => {});
    await page.waitForFunction(() => document.querySelector("[data-action=power-off]").ariaPressed === "true", { timeout: 500 }).catch(() => {});
  }
  await sees(page, "[data-action=power-off]", "aria-pressed", true);
  await sees(page, "[data-action=power-cut]", "aria-pressed", false);
  assert.equal(await page.$(".notice"), null);
  await click(page, "[data-action=power-on]");
  await sees(page, "[data-action=power-on]", "aria-pressed", true);
});

atEach("a trace that the page gives replays", async ({ bench, page }) => {
  await bench.write("Speed", 20_000);
  await bench.write("MotionControl", 1);
  await sees(page, "[data-motion=position]", "data-value", 10_000);
  const folder = mkdtempSync(join(tmpdir(), "drivetwin-page-"));
  const client = await page.createCDPSession();
  await client.send("Browser.setDownloadBehavior", { behavior: "allow", downloadPath: folder, eventsEnabled: true });
  const done = new Promise(resolve => client.on("Browser.downloadProgress", ({ state }) => state === "completed" && resolve()));
  await click(page, "[data-download=trace]");
  await done;
  const [file] = readdirSync(folder);
  assert.match(readFileSync(join(folder, file), "utf8"), /^drivetwin trace 1\n/);
  execFileSync(DRIVETWIN, ["replay", join(folder, file)]);
});

atEach("manual time advances by a step and to the next event", async ({ bench, page }) => {
  await sees(page, "[data-time]", "data-state", "manual");
  const before = await page.$eval("[data-time]", node => Number(node.getAttribute("data-value")));
  await click(page, "[data-action=advance]");
  await page.waitForFunction(before => Number(document.querySelector("[data-time]").getAttribute("data-value")) > before, {}, before);
  assert.ok((await bench.call("GET", "bench")).time.seconds > before);
}, { manual: true });

test("a bench that ends shows as lost, and comes back", async () => {
  const control = "127.0.0.1:18099";
  let bench = await run("md3", "--fast-boot", "--control", control);
  const { page } = await open(browser, `${bench.control}/#/md3`);
  try {
    await sees(page, "[data-motion=position]", "data-value", 0);
    // The second bench has less time behind it.
    await bench.call("PUT", "api/time", { mode: "manual" });
    await bench.call("POST", "api/time/advance", { seconds: 3600 });
    await page.waitForFunction(() => document.querySelector("[data-time]").dataset.value >= 3600);
    await click(page, "[data-action=record]");
    await sees(page, "[data-action=record]", "data-state", "on");
    await bench.stop();
    await page.waitForSelector("html.lost", { timeout: 10_000 });
    assert.equal(await page.$eval("#downloads", node => node.inert), true);
    bench = await run("md3", "--fast-boot", "--control", control);
    await page.waitForSelector("html:not(.lost)", { timeout: 10_000 });
    assert.match(await textOf(page, ".notice"), /^The bench has started again: /);
    await sees(page, "[data-action=record]", "data-state", "off");
  } finally {
    await page.close();
    await bench.stop();
  }
});

for (const place of PLACES) for (const [theme, width] of [["light", 1440], ["dark", 1440], ["light", 390]]) {
  test(`${place.name}: nothing bars a person who cannot see or point, ${theme}, ${width} px`, async () => {
    const axe = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
    const bench = await place.begin();
    after(() => bench.end());
    for (const route of ["#/", "#/md3"]) {
      const { page, faults } = await open(browser, "about:blank", { width, theme });
      await page.setBypassCSP(true);
      await page.goto(`${bench.address}${route}`);
      await page.waitForSelector(route === "#/" ? "[data-listed=md3]" : "[data-drive=md3]");
      await page.evaluate(axe);
      const { violations } = await page.evaluate(() => window.axe.run());
      assert.deepEqual(violations.map(({ id, nodes }) => [id, nodes.map(node => node.target.join(" "))]), []);
      const overflow = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
      assert.ok(overflow <= 0, `${route} is ${overflow} px too wide`);
      assert.deepEqual(faults.filter(fault => !fault.startsWith("asks for")), []);
      await page.close();
    }
  });
}
