// A server of files, as dumb as they come: for the static site.

import { createReadStream, existsSync } from "node:fs";
import { createServer } from "node:http";
import { extname, join, normalize } from "node:path";

const MEDIA = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml" };

/** Serves a folder below a path of its own; resolves to {address, close()}. */
export function serve(folder) {
  const below = "/deep/below/";
  const server = createServer((request, response) => {
    const path = decodeURIComponent(new URL(request.url, "http://x").pathname);
    const name = normalize(path.slice(below.length) || "index.html");
    const file = join(folder, name);
    if (!path.startsWith(below) || name.startsWith("..") || !existsSync(file)) {
      response.writeHead(404).end();
      return;
    }
    // A server that does not know WebAssembly, and the site does not need to.
    response.writeHead(200, { "Content-Type": MEDIA[extname(file)] ?? "application/octet-stream" });
    createReadStream(file).pipe(response);
  });
  return new Promise(resolve => server.listen(0, "127.0.0.1", () => resolve({
    address: `http://127.0.0.1:${server.address().port}${below}`,
    close: () => server.close(),
  })));
}
