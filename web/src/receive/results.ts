// What was read: texts, files and how far they are, pictures as soon as they are whole.

import { save } from "../common/api";
import { bytes, make, one } from "../common/dom";
import { unpacked, type Row } from "./rows";

/** Kinds of pictures that are shown, by what their names end in; nothing else of the air is given a kind. */
const PICTURES: Record<string, string> = {
  jpg: "image/jpeg", jpeg: "image/jpeg", png: "image/png", gif: "image/gif", webp: "image/webp", avif: "image/avif",
};

/** Texts that are shown of a file, at most so many bytes. */
const SHOWN = 20_000;

/** Rows of what happened that are kept. */
const MOST_ROWS = 200;

export class Results {
  private readonly got = one("got", HTMLElement);
  private readonly log = one("log", HTMLElement);
  private readonly entries = new Map<string, HTMLElement>();
  private readonly urls: string[] = [];

  clear(): void {
    this.got.replaceChildren();
    this.log.replaceChildren();
    this.entries.clear();
    this.urls.splice(0).forEach((url) => URL.revokeObjectURL(url));
  }

  get count(): number {
    return this.entries.size;
  }

  take(row: Row): void {
    if (row.event === "message") this.message(row);
    else if (row.event === "file") this.file(row);
    const words = said(row);
    if (words === "") return;
    this.log.prepend(make("li", {}, words));
    if (this.log.childElementCount > MOST_ROWS) this.log.lastElementChild?.remove();
  }

  /** The same text may come in several layers: it is shown once, with all their names. */
  private message(row: Row & { event: "message" }): void {
    const key = `message ${row.data}`;
    const known = this.entries.get(key);
    if (known !== undefined) {
      const layers = known.querySelector(".layers");
      if (layers !== null && !layers.textContent?.includes(row.layer)) layers.append(`, ${row.layer}`);
      return;
    }
    if (row.bytes === 0) return;
    const data = unpacked(row.data);
    const parts: (Node | string)[] = [
      make("p", { class: "dim" }, `Message, ${bytes(row.bytes)}, layer `, make("span", { class: "layers" }, row.layer)),
    ];
    parts.push(row.text === undefined ? make("p", {}, "Not text.") : make("pre", { class: "text", tabindex: 0 }, row.text));
    parts.push(make("div", { class: "row" },
      ...(row.text === undefined ? [] : [copyButton(row.text)]),
      this.download(new Blob([data]), row.text === undefined ? "message.bin" : "message.txt"),
    ));
    this.add(key, make("li", { class: "entry" }, ...parts));
  }

  private file(row: Row & { event: "file" }): void {
    const key = `file ${row.file}`;
    const entry = this.entries.get(key) ?? this.add(key, make("li", { class: "entry" }));
    if (!row.whole || row.data === undefined) {
      const words = `File: ${row.symbols} of ${row.needed} parts received, ${bytes(row.bytes)} in total`;
      entry.replaceChildren(
        make("p", {}, words),
        make("progress", { max: row.needed, value: row.symbols, "aria-label": "Parts of the file" }),
        ...(row.reason === undefined ? [] : [make("p", { class: "dim" }, row.reason)]),
      );
      return;
    }
    const data = unpacked(row.data);
    const name = row.name ?? "file";
    const kind = PICTURES[/\.([A-Za-z0-9]+)$/.exec(name)?.[1]?.toLowerCase() ?? ""];
    const blob = new Blob([data], { type: kind ?? "application/octet-stream" });
    const parts: Node[] = [make("p", {}, `File ${name}, ${bytes(data.length)}, complete`)];
    if (kind !== undefined) parts.push(make("img", { src: this.url(blob), alt: `The picture ${name} that was received` }));
    else if (name.endsWith(".txt")) {
      parts.push(make("pre", { class: "text", tabindex: 0 }, new TextDecoder().decode(data.subarray(0, SHOWN))));
    }
    parts.push(this.download(blob, name));
    entry.replaceChildren(...parts);
  }

  private add(key: string, entry: HTMLElement): HTMLElement {
    this.entries.set(key, entry);
    this.got.append(entry);
    if (this.entries.size === 1) entry.scrollIntoView({ block: "nearest" });
    return entry;
  }

  private url(blob: Blob): string {
    const url = URL.createObjectURL(blob);
    this.urls.push(url);
    return url;
  }

  private download(blob: Blob, name: string): HTMLElement {
    const button = make("button", { type: "button" }, `Save ${name}`);
    button.addEventListener("click", () => save(blob, name));
    return button;
  }
}

function copyButton(text: string): HTMLElement {
  const button = make("button", { type: "button" }, "Copy");
  button.addEventListener("click", () => {
    navigator.clipboard.writeText(text).then(
      () => { button.textContent = "Copied"; },
      () => { button.textContent = "Copy was refused"; },
    );
  });
  return button;
}

/** A row in words; nothing for those that are shown elsewhere. */
function said(row: Row): string {
  switch (row.event) {
    case "found": return `${row.time_s.toFixed(1)} s: patterns found`;
    case "lost": return `${row.time_s.toFixed(1)} s: patterns lost`;
    case "packet": {
      const words = Object.entries(row.layers).map(
        ([name, list]) => `${name} ${list.filter((word) => word.status === "ok").length} of ${list.length}`,
      );
      return `${row.time_s.toFixed(1)} s: packet, codewords decoded: ${words.join(", ")}`;
    }
    case "message": return `message in the ${row.layer} layer, ${bytes(row.bytes)}`;
    case "file": return row.whole ? `file ${row.name ?? ""} is complete` : "";
    case "light": return row.rate_hz === null ? "" : `the screen shows ${Number(row.rate_hz.toFixed(2))} patterns per second`;
    default: return "";
  }
}
