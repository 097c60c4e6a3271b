// The panels, drawn from the model.

import { bytes, make, one } from "../common/dom";
import { speedWords } from "./frame";
import { drawGrey } from "./grey";
import { drawLights } from "./lights";
import { pictureType, type Model } from "./model";
import { arrayName, LAYERS, type About, type Bin, type Histogram, type Layer, type LeftOut } from "./rows";
import { drawing, svg } from "./svg";
import type { Mark, Span } from "./timeline";

function put(id: string, ...children: (Node | string)[]): void {
  one(id, HTMLElement).replaceChildren(...children);
}

function head(...names: string[]): HTMLTableSectionElement {
  return make("thead", {}, make("tr", {}, ...names.map((name) => make("th", { scope: "col" }, name))));
}

function line(name: string, ...cells: string[]): HTMLTableRowElement {
  return make("tr", {}, make("th", { scope: "row" }, name), ...cells.map((cell) => make("td", {}, cell)));
}

function arrays(model: Model, about: About | null): void {
  const boxes = new Map(about?.boxes.map((box) => [box.id, box]));
  const known = new Map(model.arrays.map((array) => [array.id, array]));
  const ids = [...new Set([...boxes.keys(), ...known.keys()])].sort((a, b) => a - b);
  const rows = ids.map((id) => {
    const box = boxes.get(id);
    const counts = known.get(id);
    const layers = LAYERS.map((layer) => {
      const tally = counts?.layers[layer];
      return tally === undefined ? "" : `${tally.ok} of ${tally.ok + tally.failed}`;
    });
    const where = box === undefined ? "lost" : box.seen ? `${box.distance_m.toFixed(1)} m` : "out of sight";
    return line(arrayName(box ?? { id }), where, speedWords(model.approach.get(id)), String(counts?.packets ?? 0), ...layers);
  });
  const body = rows.length > 0 ? rows : [make("tr", {}, make("td", { colspan: 7, class: "dim" }, "No array found yet."))];
  put("arrays", head("Array", "Distance", "Speed", "Packets", "High", "Middle", "Low"), make("tbody", {}, ...body));
}

function light(model: Model): void {
  const row = model.light;
  drawGrey("received", row?.received, "Received");
  drawGrey("equalised", row?.equalised, "Equalised");
  drawGrey("decided", row?.decided, "Decided");
  const words = row === null ? "" : row.reason ?? `${arrayName(row)}, ${row.time_s.toFixed(3)} s, pair ${row.pair ?? "?"} of ${row.pairs ?? "?"}; ${row.how ?? ""}`;
  put("light-note", words);
}

function bars(layer: Layer, one: Histogram): HTMLElement {
  const [width, height, count] = [150, 48, one.zeros.length];
  const most = Math.max(1, ...one.zeros, ...one.ones, ...one.open);
  const step = width / count;
  const parts = (["open", "ones", "zeros"] as const).flatMap((kind) => one[kind].map((value, k) => {
    const tall = (value / most) * (height - 2);
    return svg("rect", { x: k * step + 0.5, y: height - tall, width: step - 1, height: tall, class: `bar ${kind} ${layer}` });
  }));
  const middle = svg("line", { x1: width / 2, x2: width / 2, y1: 0, y2: height, class: "axis" });
  const read = one.known === 0 ? "not decoded" : `${one.wrong} of ${one.known} bits wrong`;
  return make("figure", { class: "bars" },
    drawing(width, height, `Soft values of the ${layer} layer, axis to ±${Number(one.scale.toPrecision(2))}: ${read}`, ...parts, middle),
    make("figcaption", {}, make("span", { class: `layer ${layer}` }, layer), make("br"), read));
}

function soft(model: Model): void {
  const layers = model.light?.layers;
  put("soft", ...(layers === undefined ? [] : LAYERS.map((layer) => bars(layer, layers[layer]))));
}

/** Shapes of points by layer, about (0, 0). */
const SHAPES: Record<Layer, string> = { high: "M-3 0a3 3 0 1 0 6 0a3 3 0 1 0-6 0", middle: "M-3-3h6v6h-6z", low: "M0-4l4 7h-8z" };

/** Draws the wrong bits of each packet over time; a point at the upper edge is not decoded, so its errors are unknown. */
export function drawBits(marks: Mark[], { from_s, to_s }: Span, now_s: number | null): void {
  if (marks.length === 0) {
    put("bits", make("p", { class: "dim" }, "No packet yet."));
    return;
  }
  const [width, height, left, top, bottom] = [440, 136, 34, 16, 30];
  const rates = marks.flatMap((mark) => LAYERS.map((layer) => mark.layers[layer].wrong ?? 0));
  const most = [0.05, 0.1, 0.2, 0.5].find((rate) => rate >= Math.max(...rates)) ?? 0.5;
  const x = (time_s: number): number => left + ((time_s - from_s) / (to_s - from_s)) * (width - left - 8);
  const y = (rate: number): number => top + (1 - rate / most) * (height - top - bottom);
  const grid = [0, most / 2, most].flatMap((rate) => [
    svg("line", { x1: left, x2: width - 8, y1: y(rate), y2: y(rate), class: "axis" }),
    svg("text", { x: left - 4, y: y(rate) + 4, class: "tick", "text-anchor": "end" }, `${Number((rate * 100).toFixed(1))}`),
  ]);
  const step = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 60].find((seconds) => (to_s - from_s) / seconds <= 8) ?? (to_s - from_s) / 8;
  const ticks = Array.from({ length: Math.floor((to_s - from_s) / step) + 1 }, (_, k) => from_s + k * step).map((time_s) =>
    svg("text", { x: x(time_s), y: height - 17, class: "tick", "text-anchor": "middle" }, `${Number(time_s.toFixed(2))}`));
  const points = LAYERS.flatMap((layer) => {
    const measured = marks.filter((mark) => mark.layers[layer].wrong !== undefined);
    const known = measured.filter((mark) => mark.layers[layer].wrong !== null);
    return [
      ...[...new Set(known.map((mark) => mark.id))].map((id) => svg("polyline", { class: `curve ${layer}`,
        points: known.filter((mark) => mark.id === id).map((mark) => `${x(mark.time_s).toFixed(1)},${y(mark.layers[layer].wrong ?? 0).toFixed(1)}`).join(" ") })),
      ...measured.filter((mark) => mark.layers[layer].all > 0).map((mark) => {
        const wrong = mark.layers[layer].wrong ?? null;
        return svg("path", { d: SHAPES[layer], class: wrong === null ? `point open ${layer}` : `point ${layer}`,
          transform: `translate(${x(mark.time_s).toFixed(1)} ${(wrong === null ? 7 : y(wrong)).toFixed(1)})` });
      }),
    ];
  });
  const cursor = now_s === null ? [] : [svg("line", { x1: x(now_s), x2: x(now_s), y1: 2, y2: height - bottom, class: "now" })];
  const legend = LAYERS.map((layer) => make("span", { class: "key" }, svg("svg", { viewBox: "-5 -5 10 10", "aria-hidden": "true", class: "drawing" }, svg("path", { d: SHAPES[layer], class: `point ${layer}` })), layer));
  put("bits", make("figure", {},
    drawing(width, height, "Percent of wrong bits before error correction, by time and layer", ...grid, ...ticks, ...cursor, ...points,
      svg("text", { x: width / 2, y: height - 3, class: "tick", "text-anchor": "middle" }, "time (s)")),
    make("figcaption", { class: "keys" }, ...legend, make("span", {}, "bits wrong (%); hollow, at the top: not decoded"))));
}

let shownPicture: string | null = null;

function picture(model: Model): void {
  const data = model.picture?.data ?? null;
  if (data === shownPicture) return;
  shownPicture = data;
  const type = data === null ? null : pictureType(data);
  if (data === null || type === null) {
    put("picture", make("p", { class: "dim" }, "No picture yet."));
    return;
  }
  const old = one("picture", HTMLElement).querySelector("img");
  if (old !== null) URL.revokeObjectURL(old.src);
  const blob = new Blob([Uint8Array.from(atob(data), (c) => c.charCodeAt(0))], { type });
  const image = make("img", { alt: `The newest picture that was received, ${bytes(blob.size)}` });
  image.src = URL.createObjectURL(blob);
  const packet = model.picture?.packet;
  const when = packet === undefined ? "" : `complete at ${packet.time_s.toFixed(2)} s, ${packet.distance_m.toFixed(0)} m away: `;
  const caption = make("figcaption", { class: "dim small" }, `${when}picture ${model.picture?.count ?? 1}, ${bytes(blob.size)}`);
  image.onload = () => caption.append(`, ${image.naturalWidth} by ${image.naturalHeight} px`);
  image.onerror = () => put("picture", make("p", { class: "dim" }, "The picture is damaged."));
  put("picture", make("figure", {}, image, caption));
}

function messages(model: Model): void {
  // traffic lights and pictures have panels of their own
  const listed = model.messages.filter((row) => row.text !== undefined || row.road?.reason !== undefined || (row.road === undefined && pictureType(row.data) === null));
  const part = (had: number, of: number, name: string): HTMLElement =>
    make("label", { class: "wide small" }, name, make("progress", { max: of, value: had }));
  const files = [...model.files.values()].map((file) => part(Math.min(file.symbols, file.needed), file.needed,
    file.whole ? `file ${file.name ?? file.file}: complete, ${bytes(file.bytes)}` : `file of ${bytes(file.bytes)}: ${file.symbols} of ${file.needed} symbols`));
  const open = model.unfinished.slice(0, 3).map((one) => part(one.had, one.bytes, `array ${one.id}, ${one.layer} layer, message ${one.stream}: ${one.had} of ${one.bytes} bytes`));
  put("unfinished", ...files, ...open);
  // a message that several arrays send is listed once
  const same = (a: typeof listed[number], b: typeof listed[number]): boolean => a.layer === b.layer && a.text === b.text && a.data === b.data;
  put("messages", ...listed.filter((row, k) => listed.findIndex((one) => same(one, row)) === k).map((row) => {
    const ids = [...new Set(listed.filter((one) => same(one, row)).map((one) => one.id))].sort((a, b) => a - b);
    const said = row.text ?? (row.road !== undefined ? `${row.road.kind}: ${row.road.reason}` : "data");
    return make("li", {}, make("span", { class: `layer ${row.layer}` }, row.layer), " ",
      make("span", { class: "dim" }, `array ${ids.join(", ")} · ${bytes(row.bytes)}`),
      make("div", { class: "text" }, said.length > 150 ? `${said.slice(0, 150)}…` : said));
  }));
}

function packets(model: Model): void {
  put("packets", ...model.packets.map((row) => {
    const words = LAYERS.map((layer) => {
      const list = row.layers[layer] ?? [];
      const read = list.filter((word) => word.status === "ok").length;
      return make("span", { class: `layer ${layer}` }, `${layer} ${read}/${list.length}`);
    });
    return make("li", {}, `${row.time_s.toFixed(3)} s · ${arrayName(row)} · ${row.distance_m.toFixed(1)} m `, ...words.flatMap((word) => [word, " "]), row.reason ?? "");
  }));
}

function percent(rate: number): string {
  return `${Number((rate * 100).toPrecision(rate >= 0.095 ? 2 : 1))}\u00a0%`;
}

function counted({ wrong, sent, high }: { wrong: number; sent: number; high: number }): string {
  return sent === 0 ? "" : `${wrong} of ${sent}${wrong === 0 ? `, < ${percent(high)}` : ""}`;
}

function chart(bins: Bin[]): SVGElement {
  const [width, height, left, bottom] = [340, 150, 34, 22];
  const from = Math.min(...bins.map((bin) => bin.from_m));
  const to = Math.max(...bins.map((bin) => bin.to_m));
  const x = (metres: number): number => left + ((metres - from) / Math.max(to - from, 5)) * (width - left - 6);
  const y = (rate: number): number => 6 + (1 - rate) * (height - bottom - 6);
  const grid = [0, 0.5, 1].flatMap((rate) => [
    svg("line", { x1: left, x2: width - 6, y1: y(rate), y2: y(rate), class: "axis" }),
    svg("text", { x: left - 4, y: y(rate) + 4, class: "tick", "text-anchor": "end" }, `${rate * 100}`),
  ]);
  const ticks = bins.map((bin) => svg("text", { x: x((bin.from_m + bin.to_m) / 2), y: height - 6, class: "tick", "text-anchor": "middle" }, `${bin.from_m}`));
  const marks = LAYERS.flatMap((layer, k) => bins.filter((bin) => bin.layers[layer].sent > 0).flatMap((bin) => {
    const one = bin.layers[layer];
    const at = x((bin.from_m + bin.to_m) / 2) + (k - 1) * 5;
    return [
      svg("line", { x1: at, x2: at, y1: y(one.low), y2: y(one.high), class: `mark ${layer}` }),
      svg("circle", { cx: at, cy: y(one.wrong / one.sent), r: 3, class: `dot ${layer}` }),
    ];
  }));
  return drawing(width, height, "Percent of failed codewords by distance in m, with 95 % intervals; the table has the counts", ...grid, ...ticks, ...marks);
}

function errors(model: Model): void {
  const bins = model.errors;
  if (bins === null || bins.length === 0) {
    const why = model.source === null ? "Requires the ground truth: a simulated drive, or a video with a truth file."
      : model.source.truth ? "No complete packet yet." : "No ground truth for this source.";
    put("errors", make("p", { class: "dim" }, why));
    return;
  }
  const rows = [...bins].reverse().map((bin) => line(`${bin.from_m}–${bin.to_m} m`, ...LAYERS.map((layer) => counted(bin.layers[layer]))));
  put("errors", chart(bins), make("div", { class: "scrolls", tabindex: 0, role: "region", "aria-label": "Counts by distance" },
    make("table", { class: "small" }, head("m", "High", "Middle", "Low"), make("tbody", {}, ...rows))),
  make("p", { class: "dim small" }, `Failed codewords (%) by distance (m), with 95 % intervals. False decodes: ${model.falseCodewords}.`));
}

const STAGE_WORDS: Record<string, string> = {
  render: "simulation", read: "reading of frames", search: "search and others", find: "detection",
  follow: "tracking", "take pairs": "extraction of pairs", equalise: "equalisation", decode: "decoding", show: "display",
};

function stages(model: Model): void {
  const state = model.state;
  const times = Object.entries(state?.stages ?? {}).filter(([name]) => name !== "wait").sort((a, b) => b[1] - a[1]);
  if (state === null || times.length === 0) {
    put("stages", make("p", { class: "dim" }, "No times."));
    return;
  }
  const total = times.reduce((sum, [, seconds]) => sum + seconds, 0);
  const rows = times.map(([name, seconds]) => make("tr", {}, make("th", { scope: "row" }, STAGE_WORDS[name] ?? name),
    make("td", {}, make("progress", { max: Math.max(total, 1e-9), value: seconds, "aria-label": STAGE_WORDS[name] ?? name })),
    make("td", {}, `${((1000 * seconds) / Math.max(state.frames, 1)).toFixed(2)}`), make("td", {}, percent(seconds / Math.max(total, 1e-9)))));
  put("stages", make("table", { class: "small" }, head("Stage", "Share", "ms/frame", "%"), make("tbody", {}, ...rows)),
    make("p", { class: "dim small" }, `${state.frames} frames at ${(state.frames / Math.max(total, 1e-9)).toFixed(0)} frames/s, pauses not counted.`), ...leftOut(state.left_out));
}

/** Areas beyond the limit of the search. */
function leftOut(left: LeftOut): HTMLElement[] {
  if (left.candidates + left.blocks === 0) return [];
  return [make("p", { class: "dim small" }, `The search skipped ${left.candidates} candidates and ${left.blocks} blocks, because too many areas of the frame flicker.`)];
}

/** Draws all panels: those that cost more only when their rows changed. */
export class Panels {
  private drawn: { [name: string]: unknown } = {};

  draw(model: Model, about: About | null): void {
    arrays(model, about);
    this.once("light", model.light, () => { light(model); soft(model); });
    picture(model);
    drawLights(model, about?.time_s ?? null);
    this.once("messages", model.unfinished, () => messages(model));
    this.once("packets", model.packets[0], () => packets(model));
    this.once("state", model.state, () => { errors(model); stages(model); });
  }

  private once(name: string, key: unknown, draw: () => void): void {
    if (name in this.drawn && this.drawn[name] === key) return;
    this.drawn[name] = key;
    draw();
  }

  forget(): void {
    this.drawn = {};
  }
}
