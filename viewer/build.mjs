// Builds the page: script and style of src/ inside shell.html, written to src/ros2_mcp/view/page.html.
//   npm install --no-package-lock --ignore-scripts && npm run build
// `--check` writes nothing, and fails if the committed file is another one.
import { build } from "esbuild";
import { readFileSync, writeFileSync } from "node:fs";
import { gzipSync } from "node:zlib";

const OUT = new URL("../src/ros2_mcp/view/page.html", import.meta.url);
const MOST_GZ = 400_000;
const at = (name) => new URL(name, import.meta.url);

const made = await build({
  entryPoints: ["src/main.ts"], absWorkingDir: at(".").pathname, bundle: true, minify: true, write: false,
  format: "iife", target: "es2022", charset: "utf8", legalComments: "none",
});
const script = made.outputFiles[0].text.trim().replaceAll("</script", "<\\/script");
const { code: style } = await (await import("esbuild")).transform(readFileSync(at("src/style.css"), "utf8"), {
  loader: "css", minify: true, charset: "utf8",
});
// Replaced by functions: in a text, `$&` would have a meaning.
const html = readFileSync(at("src/shell.html"), "utf8")
  .replace("/*STYLE*/", () => style.trim())
  .replace("/*SCRIPT*/", () => script);
const size = gzipSync(html).length;
if (size > MOST_GZ) throw new Error(`The page has ${size} bytes gz; ${MOST_GZ} are allowed.`);
if (process.argv.includes("--check")) {
  if (readFileSync(OUT, "utf8") !== html) {
    console.error("src/ros2_mcp/view/page.html is not what viewer/src makes: cd viewer && npm run build");
    process.exit(1);
  }
} else {
  writeFileSync(OUT, html);
}
console.log(`page.html: ${html.length} characters, ${size} bytes gz`);
