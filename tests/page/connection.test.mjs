// What the page says of its connection to the bench, and how many connections it takes.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { browser as startBrowser, click, hide, open, run, sees, textOf } from "./bench.mjs";

let browser;
before(async () => { browser = await startBrowser(); });
after(() => browser.close());

test("hidden pages hold no connection, and one that is shown again follows the bench", async () => {
  const bench = await run("md3", "--fast-boot", "--time", "manual");
  const pages = [];
  try {
    // A browser has six connections for each host: without them the seventh page would not load.
    for (let count = 0; count < 7; count++) {
      const { page } = await open(browser, `${bench.control}/#/md3`);
      pages.push(page);
      await sees(page, "[data-motion=position]", "data-value", 0);
      await hide(page, true);
    }
    await bench.call("PUT", "api/drives/md3/pins/J2.2", { level: "low" });
    await pages[0].bringToFront();
    await hide(pages[0], false);
    await bench.call("POST", "api/time/advance", { seconds: 1 });
    await sees(pages[0], "[data-pin='J2.2']", "data-state", "low");
    await click(pages[0], "[data-pin='J2.2'] [data-set=open]");
    await sees(pages[0], "[data-pin='J2.2']", "data-state", "high");
  } finally {
    await Promise.all(pages.map(page => page.close()));
    await bench.stop();
  }
});

test("the head of the page holds all of its controls at each width", async () => {
  const bench = await run("md3", "--fast-boot", "--time", "manual");
  try {
    await bench.call("POST", "api/time/advance", { seconds: 3600 });
    for (const width of [320, 390, 640, 861, 900, 1000, 1280, 1281, 1440]) {
      const { page } = await open(browser, `${bench.control}/#/md3`, { width });
      await sees(page, "[data-time]", "data-state", "manual");
      await click(page, "[data-action=record]");
      await sees(page, "[data-action=record]", "data-state", "on");
      const outside = await page.$$eval(".bar :is(button, input, .hint, .clock)", nodes => nodes.filter(node => {
        const { left, right, height } = node.getBoundingClientRect();
        return height > 40 || left < 0 || right > innerWidth || node.scrollWidth > node.clientWidth + 1;
      }).map(node => node.outerHTML));
      assert.deepEqual(outside, [], `at ${width} px`);
      await page.close();
    }
  } finally {
    await bench.stop();
  }
});

test("a bench that hangs is said to, and one whose time stands is not", async () => {
  const bench = await run("md3", "--fast-boot", "--time", "manual");
  const { page } = await open(browser, `${bench.control}/#/md3`);
  try {
    await sees(page, "[data-motion=position]", "data-value", 0);
    // Nothing changes: the page asks, and the answers come.
    for (let count = 0; count < 4; count++) await page.waitForResponse(`${bench.control}/api/drives/md3`);
    assert.equal(await page.$("html.lost"), null);
    bench.hang(true);
    await page.waitForSelector("html.lost", { timeout: 10_000 });
    assert.match(await textOf(page, "#link"), /^No answer for \d+ s$/);
    // A call that waits says so.
    await page.$eval("[data-action=power-off]", button => button.click());
    assert.match(await textOf(page, ".notice"), /^The bench has not answered for 2 s/);
    bench.hang(false);
    await page.waitForSelector("html:not(.lost)", { timeout: 10_000 });
    await sees(page, "[data-action=power-off]", "aria-pressed", true);
    await page.waitForFunction(() => document.querySelector(".notice") === null);
  } finally {
    bench.hang(false);
    await page.close();
    await bench.stop();
  }
});
