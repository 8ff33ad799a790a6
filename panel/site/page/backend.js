// The site's way to a bench: see the page's own module of this name.

export { bench as backend } from "./bench.js";
