// Builds the pages into the Python package, with a note of the sources that they were built from.
import { createHash } from "node:crypto";
import { readdirSync, readFileSync, statSync, writeFileSync } from "node:fs";
import { join, relative, resolve, sep } from "node:path";
import { defineConfig, type Plugin } from "vite";

const here = import.meta.dirname;
const pages = resolve(here, "../src/heliograph/web/pages");
const names = ["index", "watch", "transmit", "receive", "glossary"];
// what the built pages depend on; the Python test that reads the note has the same list
const sources = ["src", "parts", "public", "package-lock.json", "package.json", "tsconfig.json", "vite.config.ts",
  ...names.map((name) => `${name}.html`)];

function filesOf(path: string): string[] {
  if (!statSync(path).isDirectory()) return [path];
  return readdirSync(path).flatMap((name) => filesOf(join(path, name)));
}

function digest(root: string, files: string[]): Record<string, string> {
  const entries = files.map((file) => [
    relative(root, file).split(sep).join("/"),
    createHash("sha256").update(readFileSync(file)).digest("hex"),
  ]);
  return Object.fromEntries(entries.sort());
}

/** Puts the parts that all pages share where a page has <!-- name -->. */
function parts(): Plugin {
  return {
    name: "parts",
    transformIndexHtml: {
      order: "pre",
      handler: (html, context) => {
        const page = context.path.replace(/^\/|\.html$/g, "");
        return html.replace(/<!-- (head|nav) -->/g, (_, name: string) =>
          readFileSync(join(here, "parts", `${name}.html`), "utf8").trimEnd()
            .replace(`href="${page === "index" ? "./" : page}"`, (link) => `${link} aria-current="page"`));
      },
    },
  };
}

/** Notes the digests of sources and of what was built, by which a test knows whether the build is theirs. */
function note(): Plugin {
  return {
    name: "note",
    closeBundle: () => {
      const built = digest(pages, filesOf(pages).filter((file) => !file.endsWith("build.json")));
      const from = digest(here, sources.flatMap((name) => filesOf(join(here, name))));
      writeFileSync(join(pages, "build.json"), JSON.stringify({ sources: from, built }, null, 1) + "\n");
    },
  };
}

export default defineConfig({
  root: here,
  base: "./",
  plugins: [parts(), note()],
  build: {
    outDir: pages,
    emptyOutDir: true,
    target: "es2022",
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    rollupOptions: {
      input: Object.fromEntries(names.map((name) => [name, join(here, `${name}.html`)])),
      // nothing is kept by browsers, so names need not tell versions apart
      output: { entryFileNames: "assets/[name].js", chunkFileNames: "assets/[name].js", assetFileNames: "assets/[name][extname]" },
    },
  },
});
