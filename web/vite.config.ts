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

/** Puts scripts and styles of page Watch into one file, with a place for a recorded run. */
function singleFile(): Plugin {
  return {
    name: "single-file",
    enforce: "post",
    generateBundle: (_, bundle) => {
      const page = bundle["watch.html"];
      if (page?.type !== "asset") throw new Error("no page");
      let html = String(page.source);
      for (const [name, file] of Object.entries(bundle)) {
        if (name === "watch.html") continue;
        const tag = new RegExp(`<(script|link)[^>]*${name.replace(/[.]/g, "\\.")}"[^>]*>(</script>)?`);
        const text = file.type === "chunk" ? `<script type="module">${file.code.replaceAll("</script", "<\\/script")}</script>` : `<style>${file.source}</style>`;
        // a replacement text may hold "$&"
        html = html.replace(tag, () => (file.type === "chunk" ? "" : text));
        if (file.type === "chunk") html = html.replace("</body>", () => `<script type="application/json" id="run">RUN</script>\n${text}\n</body>`);
        delete bundle[name];
      }
      page.source = html.replace(/<link rel="icon"[^>]*>/, '<link rel="icon" href="data:,">');
      page.fileName = "replay.html";
    },
  };
}

export default defineConfig(({ mode }) => mode === "replay" ? {
  root: here,
  publicDir: false,
  base: "./",
  plugins: [parts(), singleFile(), note()],
  build: {
    outDir: pages, emptyOutDir: false, target: "es2022", assetsInlineLimit: 0, modulePreload: { polyfill: false },
    rollupOptions: { input: join(here, "watch.html"), output: { inlineDynamicImports: true, entryFileNames: "watch.js", assetFileNames: "[name][extname]" } },
  },
} : {
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
