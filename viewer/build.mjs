// Builds the page: script and style of src/ inside shell.html, written to src/ros2_mcp/view/page.html.
//   npm install --no-package-lock --ignore-scripts && npm run build
// `--check` writes nothing, and fails if the committed file is another one.
import { build, transform } from "esbuild";
import { readFileSync, readdirSync, writeFileSync } from "node:fs";
import { gzipSync } from "node:zlib";

const OUT = new URL("../src/ros2_mcp/view/page.html", import.meta.url);
const MOST_GZ = 400_000;
const at = (name) => new URL(name, import.meta.url);
const read = (name) => readFileSync(at(name), "utf8");
const { dependencies } = JSON.parse(read("package.json"));

// The module "panels": what each file of src/panels/ exports as `kind`, by its name.
const files = readdirSync(at("src/panels")).filter((name) => name.endsWith(".ts")).map((name) => name.slice(0, -3)).sort();
const panels = {
  name: "panels",
  setup(made) {
    made.onResolve({ filter: /^panels$/ }, () => ({ path: "panels", namespace: "panels" }));
    made.onLoad({ filter: /./, namespace: "panels" }, () => ({
      resolveDir: at("src/panels").pathname,
      contents: files.map((name) => `import { kind as ${name} } from "./${name}.ts";`).join("") + `export default { ${files.join(", ")} };`,
    }));
  },
};
const made = await build({
  entryPoints: ["src/main.ts"], plugins: [panels], absWorkingDir: at(".").pathname, bundle: true, minify: true, write: false,
  format: "iife", target: "es2022", charset: "utf8", legalComments: "none",
});
const script = made.outputFiles[0].text.trim().replaceAll("</script", "<\\/script");
const styles = read("node_modules/uplot/dist/uPlot.min.css") + read("src/style.css");
const { code: style } = await transform(styles, { loader: "css", minify: true, charset: "utf8" });
// Their licences demand to be told with each copy.
const licences = Object.entries(dependencies).map(([name, version]) => `${name} ${version}\n\n${read(`node_modules/${name}/LICENSE`).trim()}`);
if (licences.some((text) => text.includes("--"))) throw new Error("A licence would end the comment that it stands in.");
// Replaced by functions: in a text, `$&` would have a meaning.
const html = read("src/shell.html")
  .replace("/*LICENCES*/", () => licences.join("\n\n"))
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
