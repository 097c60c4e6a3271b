// The form by which a source is chosen; a film is uploaded first.

import { onDrop } from "../common/page";
import { ask, askJson, kindOf, upload } from "../common/api";
import { make, one } from "../common/dom";
import type { Source } from "./link";

interface Sources {
  named: string[]; presets: { name: string; text: string }[]; receivers: string[];
}

function options(id: string, list: [string, string][]): void {
  one(id, HTMLSelectElement).replaceChildren(...list.map(([value, text]) => make("option", { value }, text)));
}

function numberOf(id: string): number | undefined {
  const input = one(id, HTMLInputElement);
  return input.value === "" ? undefined : input.valueAsNumber;
}

export class SourceForm {
  private readonly form = one("source", HTMLFormElement);
  private uploaded: string | null = null;
  private uploading: AbortController | null = null;

  constructor(private readonly chosen: (source: Source) => void, private readonly failed: (error: unknown) => void) {
    this.form.onsubmit = (event) => {
      event.preventDefault();
      void this.submit();
    };
    this.form.onchange = () => this.showKind();
    one("look", HTMLButtonElement).onclick = () => void this.look();
    onDrop((file) => void this.film(file));
    void this.load();
  }

  private async load(): Promise<void> {
    try {
      const sources = await askJson<Sources>("watch/sources");
      options("preset", [["", "the server"], ...sources.presets.map(({ name }): [string, string] => [name, `preset ${name}`])]);
      options("receiver", [["", "of the settings, or auto"], ...sources.receivers.map((name): [string, string] => [name, name])]);
      options("named", sources.named.map((name, k) => [String(k), name]));
      const named = this.form.querySelector<HTMLInputElement>("input[value=named]");
      if (named !== null) {
        named.disabled = sources.named.length === 0;
        if (sources.named.length > 0) named.checked = true;
        if (named.disabled) named.closest("label")?.append(" (heliograph serve FILM)");
      }
      this.showKind();
    } catch (error) {
      this.failed(error);
    }
  }

  private async look(): Promise<void> {
    try {
      const { cameras, lacking } = await askJson<{ cameras: { name: string; text: string }[]; lacking: Record<string, string> }>("watch/cameras");
      options("camera", cameras.map(({ name, text }, k) => [String(k), `${name} ${text}`]));
      if (cameras.length === 0) this.failed(new Error(`no camera found; ${Object.entries(lacking).map(([kind, why]) => `${kind}: ${why}`).join("; ")}`));
    } catch (error) {
      this.failed(error);
    }
  }

  private kind(): string {
    return new FormData(this.form).get("kind")?.toString() ?? "drive";
  }

  private showKind(): void {
    const kind = this.kind();
    for (const part of this.form.querySelectorAll<HTMLElement>("[data-kind]")) part.hidden = !part.dataset["kind"]?.split(" ").includes(kind);
  }

  private common(): Source {
    const changes = one("changes", HTMLTextAreaElement).value.split("\n").map((line) => line.trim()).filter((line) => line !== "");
    const source: Source = { kind: this.kind() };
    const [preset, receiver] = ["preset", "receiver"].map((id) => one(id, HTMLSelectElement).value);
    if (preset) source.preset = preset;
    if (receiver) source.receiver = receiver;
    if (changes.length > 0) source.changes = changes;
    return source;
  }

  private async submit(): Promise<void> {
    const source = this.common();
    if (source.kind === "film") {
      const file = one("film", HTMLInputElement).files?.[0];
      if (file === undefined) this.failed(new Error("choose a film first, or drop one on this page"));
      else await this.film(file);
      return;
    }
    if (source.kind === "drive") {
      const distance = numberOf("distance");
      Object.assign(source, { seed: numberOf("seed") ?? 0, street: one("street", HTMLInputElement).checked },
        distance === undefined ? {} : { distance_m: distance });
    } else {
      const list = one(source.kind === "named" ? "named" : "camera", HTMLSelectElement);
      if (list.value === "") {
        this.failed(new Error(source.kind === "named" ? "no film was named: start 'heliograph serve FILM'" : "look for cameras first"));
        return;
      }
      const rate = numberOf("rate");
      Object.assign(source, { number: Number(list.value) }, source.kind === "camera" || rate === undefined ? {} : { rate_hz: rate });
    }
    this.chosen(source);
  }

  private async film(file: File): Promise<void> {
    const input = this.form.querySelector<HTMLInputElement>("input[value=film]");
    if (input !== null) input.checked = true;
    this.showKind();
    const place = one("uploading", HTMLElement);
    this.uploading?.abort();
    const mine = this.uploading = new AbortController();
    try {
      place.hidden = false;
      if (this.uploaded !== null) void ask(`films/${this.uploaded}`, { method: "DELETE" }).catch(() => undefined);
      this.uploaded = await upload(file, kindOf(file), (part) => { one("progress", HTMLProgressElement).value = part; }, mine.signal);
      const rate = numberOf("rate");
      this.chosen({ ...this.common(), kind: "film", film: this.uploaded, ...(rate === undefined ? {} : { rate_hz: rate }) });
    } catch (error) {
      if (this.uploading === mine) this.failed(error);
    } finally {
      if (this.uploading === mine) place.hidden = true;
    }
  }
}
