// Fetches the module and the bench file. Both lie beside this file.

async function fetched(name) {
  const response = await fetch(new URL(name, import.meta.url));
  if (!response.ok) throw new Error(`${name}: status ${response.status}`);
  return response;
}

/** {exports, bench}: the functions of the module, and the text of the bench file. */
export async function load() {
  // Not `instantiateStreaming`: it insists on a media type, which not every server of files has.
  const [module, file] = await Promise.all([fetched("drivetwin.wasm"), fetched("bench.toml")]);
  const [{ instance }, bench] = await Promise.all([WebAssembly.instantiate(await module.arrayBuffer()), file.text()]);
  return { exports: instance.exports, bench };
}
