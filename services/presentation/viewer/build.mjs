// Bundles src/ into dist/viewer.html: one file, with the three markers that the C++ writer fills.
import { readFile, writeFile } from "node:fs/promises";
import { build } from "esbuild";

const bundle = async (entry) => {
  const result = await build({
    entryPoints: [entry],
    bundle: true,
    minify: true,
    write: false,
    format: "iife",
    target: ["chrome103", "firefox113", "safari16.4"],
    charset: "ascii",
    legalComments: "inline",
  });
  return result.outputFiles[0].text.trim();
};

const page = await readFile("src/index.html", "utf8");
const [script, style] = await Promise.all([bundle("src/main.ts"), bundle("src/style.css")]);
// Functions as replacements: `$` in the code must stay as it is.
const html = page.replace("/* STYLE */", () => style).replace("/* SCRIPT */", () => script);
for (const marker of ["PLEAT_TITLE", "PLEAT_CONNECT", "<!-- PLEAT_DATA -->"]) {
  if (html.split(marker).length !== 2) throw new Error(`${marker} must be in the page exactly once`);
}
await writeFile("dist/viewer.html", html);
console.log(`dist/viewer.html: ${html.length} bytes`);
