// Pictures of the panel, the site and the view for the documents: node pictures.mjs FOLDER

import { mkdirSync, writeFileSync } from "node:fs";
import { join } from "node:path";

import { browser as startBrowser, click, open, sees } from "./bench.mjs";
import { ofProcess } from "./places.mjs";
import { small } from "./png.mjs";
import { serve } from "./server.mjs";
import { terminal } from "./screen.mjs";

const MOST = 150_000; // bytes of a picture
const SIZE = { width: 1440, height: 900 };

const folder = process.argv[2];
mkdirSync(folder, { recursive: true });
const browser = await startBrowser();
const site = await serve(process.env.SITE);

function keep(name, png) {
  const bytes = small(Buffer.from(png));
  if (bytes.length > MOST) throw new Error(`${name} has ${bytes.length} bytes, more than ${MOST}`);
  writeFileSync(join(folder, name), bytes);
  console.log(`${name}: ${Math.round(bytes.length / 1000)} kB`);
}

const passes = (page, register, least) => page.waitForFunction((register, least) =>
  Number(document.querySelector(`[data-motion=${register}]`)?.getAttribute("data-value")) >= least, { polling: "raf", timeout: 20_000 }, register, least);

for (const theme of ["light", "dark"]) {
  const look = async (address, act) => {
    const { page } = await open(browser, address, { ...SIZE, theme });
    await act(page);
    await page.close();
  };
  const shot = async (name, page, element = page) => {
    await page.mouse.move(0, 0);
    keep(`${name}-${theme}.png`, await element.screenshot());
  };

  // A process: an MD3 in the middle of its second move.
  const bench = await ofProcess.begin();
  await look(`${bench.address}#/md3`, async page => {
    await sees(page, "[data-motion=position]", "data-value", 0);
    await bench.write("MotionControl", 1);
    await sees(page, "[data-motion=position]", "data-value", 10_000);
    // A refused write, with its bytes.
    await bench.refused("Reserved", 5);
    await click(page, "[data-traffic][data-verdict=refused] button");
    await page.waitForSelector(".frame-details");
    await page.setViewport({ width: 1240, height: 900, deviceScaleFactor: 2 });
    // As high as what it shows.
    const height = height => page.$eval(".frames-scroll", (node, height) => { node.style.maxHeight = height; }, height);
    await height("none");
    await shot("refused", page, await page.$("#traffic"));
    await height("");
    await page.setViewport(SIZE);
    await click(page, "[data-traffic][data-verdict=refused] button");
    await bench.write("MotionControl", 1);
    await passes(page, "position", 17_000);
    await page.evaluate(() => scrollTo(0, 0));
    await shot("md3", page);
  });
  await bench.end();

  // The site in the middle of a move, and its bench while three motors turn.
  await look(site.address, async page => {
    await click(page, "[data-try=move]");
    await passes(page, "position", 7000);
    await shot("site", page);
    for (const [drive, act] of [["rs434", "run"], ["mdrobot", "run"], ["md3", "refuse"], ["md3", "home"]]) {
      await page.goto(`${site.address}#/${drive}`);
      await click(page, `[data-drive=${drive}] [data-try=${act}]`);
    }
    await page.goto(`${site.address}#/`);
    await page.waitForFunction(() => document.querySelectorAll("#list .lamp[data-state=moving]").length === 3, { timeout: 20_000 });
    await new Promise(resolve => setTimeout(resolve, 700)); // until the drawing is complete
    await shot("bench", page);
  });
}
keep("view.png", await terminal(browser));
await browser.close();
site.close();
