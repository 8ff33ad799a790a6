// A bench for tests of the page: the process `drivetwin run`, and a browser.

import { spawn } from "node:child_process";
import { once } from "node:events";
import { createInterface } from "node:readline";

import puppeteer from "puppeteer-core";

/** Name of the program under test. */
export const DRIVETWIN = process.env.DRIVETWIN ?? "drivetwin";

/** Starts `drivetwin run` with these arguments; resolves when its banner is complete. */
export async function run(...args) {
  const control = args.includes("--control") ? [] : ["--control", "localhost:0"];
  const child = spawn(DRIVETWIN, ["run", ...args, ...control], { stdio: ["pipe", "pipe", "inherit"] });
  const banner = [];
  for await (const line of createInterface({ input: child.stdout })) {
    banner.push(line);
    if (line.startsWith("Ctrl-C")) break;
  }
  const words = banner.join("\n");
  const address = words.match(/http:\/\/[\d.]+:\d+/)?.[0];
  const port = Number(words.match(/tcp:127\.0\.0\.1:(\d+)/)?.[1]);
  if (!address) throw new Error(`no control address in the banner:\n${words}`);
  return {
    control: address, port,
    async call(method, path, body) {
      const headers = { "Content-Type": "application/json" };
      const answer = await fetch(`${address}/${path}`, { method, headers, body: body && JSON.stringify(body) });
      const text = await answer.text();
      if (!answer.ok) throw new Error(`${method} ${path}: ${text}`);
      return text === "" ? null : JSON.parse(text);
    },
    /** Makes the process hang, or go on. */
    hang: yes => child.kill(yes ? "SIGSTOP" : "SIGCONT"),
    async stop() {
      child.kill("SIGTERM");
      if (child.exitCode === null && child.signalCode === null) await once(child, "exit");
    },
  };
}

/** Starts a browser without a window. */
export function browser() {
  return puppeteer.launch({
    executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
    args: ["--no-sandbox", "--disable-gpu", "--force-color-profile=srgb", "--hide-scrollbars"],
  });
}

/** Opens a page that fails the test if it logs an error, or asks for anything that is not its own. */
export async function open(browser, url, { width = 1440, height = 1000, theme = "light" } = {}) {
  const page = await browser.newPage();
  const faults = [];
  page.on("pageerror", error => faults.push(String(error)));
  // The browser notes each call that the bench refuses. The page shows the sentence.
  const isRefusal = text => /status of 4\d\d/.test(text);
  page.on("console", message => message.type() === "error" && !isRefusal(message.text()) && faults.push(message.text()));
  page.on("request", request => {
    const { origin, protocol } = new URL(request.url());
    if (origin !== new URL(url).origin && protocol !== "data:" && protocol !== "blob:") faults.push(`asks for ${request.url()}`);
  });
  await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: theme }]);
  await page.setViewport({ width, height });
  await page.goto(url);
  return { page, faults };
}

/** Hides a page as another tab in front of it does, or shows it. */
export const hide = (page, yes) => page.evaluate(hidden => {
  Object.defineProperty(document, "hidden", { value: hidden, configurable: true });
  document.dispatchEvent(new Event("visibilitychange"));
}, yes);

/** Waits until an element has this attribute value; fails with what it has instead. */
export async function sees(page, selector, attribute, value) {
  const has = (selector, attribute, value) => {
    const found = document.querySelector(selector)?.getAttribute(attribute);
    return found === value;
  };
  try {
    await page.waitForFunction(has, { timeout: 10_000 }, selector, attribute, String(value));
  } catch (error) {
    const found = await page.evaluate((selector, attribute) => document.querySelector(selector)?.getAttribute(attribute), selector, attribute);
    throw new Error(`${selector} has ${attribute}="${found}" instead of "${value}"`, { cause: error });
  }
}

/** Text of the first element that fits. */
export async function textOf(page, selector) {
  const element = await page.waitForSelector(selector, { timeout: 10_000 });
  return element.evaluate(node => node.textContent.trim());
}

/** Clicks the first element that fits, as a person would. */
export async function click(page, selector) {
  const element = await page.waitForSelector(selector, { visible: true, timeout: 10_000 });
  await element.scrollIntoView();
  await element.click();
}
