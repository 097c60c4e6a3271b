// The form by which a source is chosen; a film is uploaded first.

import { onDrop } from "../common/page";
import { askJson, kindOf, upload } from "../common/api";
import { make, one } from "../common/dom";
import type { Source } from "./link";

interface Sources {
  named: string[]; recorded: boolean; presets: { name: string; text: string }[]; receivers: string[];
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
  private readonly kinds = one("kind", HTMLSelectElement);
  private uploading: AbortController | null = null;

  /** `ready` gets true if the server offers the recorded drive only. */
  constructor(private readonly chosen: (source: Source) => void, private readonly failed: (error: unknown) => void, ready: (recorded: boolean) => void) {
    this.form.onsubmit = (event) => {
      event.preventDefault();
      void this.submit();
    };
    this.form.onchange = () => this.showKind();
    one("look", HTMLButtonElement).onclick = () => void this.look();
    onDrop((file) => void this.film(file));
    void this.load().then(ready, (error: unknown) => this.failed(error));
  }

  private async load(): Promise<boolean> {
    const sources = await askJson<Sources>("watch/sources");
    options("preset", [["", "server default"], ...sources.presets.map(({ name }): [string, string] => [name, name])]);
    options("receiver", [["", "as in preset"], ...sources.receivers.map((name): [string, string] => [name, name])]);
    options("kind", [
      ...sources.named.map((name, k): [string, string] => [`named ${k}`, sources.recorded ? "Recorded drive, 80 m to 25 m" : `Video on the server: ${name}`]),
      ["film", "Video from this device"], ["camera", "Camera on the server"], ["drive", "Simulated drive (slow)"],
    ]);
    this.showKind();
    return sources.recorded;
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

  /** Starts the chosen source. */
  start(): void {
    this.form.requestSubmit();
  }

  /** Shows a source in the form. */
  show(source: Source): void {
    this.kinds.value = source.kind === "named" ? `named ${source.number ?? 0}` : source.kind;
    for (const [id, value] of [["preset", source.preset], ["receiver", source.receiver]] as const) one(id, HTMLSelectElement).value = value ?? "";
    for (const [id, value] of [["distance", source.distance_m], ["rate", source.rate_hz]] as const) one(id, HTMLInputElement).value = String(value ?? "");
    one("seed", HTMLInputElement).value = String(source.seed ?? 0);
    one("street", HTMLInputElement).checked = source.street ?? true;
    one("changes", HTMLTextAreaElement).value = (source.changes ?? []).join("\n");
    this.showKind();
  }

  private showKind(): void {
    const kind = this.kinds.value.split(" ")[0] ?? "";
    for (const part of this.form.querySelectorAll<HTMLElement>("[data-kind]")) part.hidden = !part.dataset["kind"]?.split(" ").includes(kind);
  }

  private common(): Source {
    const changes = one("changes", HTMLTextAreaElement).value.split("\n").map((line) => line.trim()).filter((line) => line !== "");
    const [kind = "drive", number] = this.kinds.value.split(" ");
    const source: Source = { kind, ...(number === undefined ? {} : { number: Number(number) }) };
    const [preset, receiver] = ["preset", "receiver"].map((id) => one(id, HTMLSelectElement).value);
    if (preset) source.preset = preset;
    if (receiver) source.receiver = receiver;
    if (changes.length > 0) source.changes = changes;
    const rate = numberOf("rate");
    if (rate !== undefined && (kind === "film" || kind === "named")) source.rate_hz = rate;
    return source;
  }

  private async submit(): Promise<void> {
    const source = this.common();
    const distance = numberOf("distance");
    const camera = one("camera", HTMLSelectElement).value;
    const file = one("film", HTMLInputElement).files?.[0];
    if (source.kind === "film" && file !== undefined) await this.film(file);
    else if (source.kind === "film") this.failed(new Error("choose a video first, or drop one on this page"));
    else if (source.kind === "camera" && camera === "") this.failed(new Error("find cameras first"));
    else if (source.kind === "camera") this.chosen({ ...source, number: Number(camera) });
    else if (source.kind === "drive") this.chosen({ ...source, seed: numberOf("seed") ?? 0, street: one("street", HTMLInputElement).checked, ...(distance === undefined ? {} : { distance_m: distance }) });
    else this.chosen(source);
  }

  private async film(file: File): Promise<void> {
    this.kinds.value = "film";
    this.showKind();
    const place = one("uploading", HTMLElement);
    this.uploading?.abort();
    const mine = this.uploading = new AbortController();
    try {
      place.hidden = false;
      const film = await upload(file, kindOf(file), (part) => { one("progress", HTMLProgressElement).value = part; }, mine.signal);
      this.chosen({ ...this.common(), film }); // the server keeps films for Back
    } catch (error) {
      if (this.uploading === mine) this.failed(error);
    } finally {
      if (this.uploading === mine) place.hidden = true;
    }
  }
}
