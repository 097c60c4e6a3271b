// The whole run: a mark for each packet, and the moments that are kept to be shown again.

import { one } from "../common/dom";
import { apply, empty, type Model } from "./model";
import { LAYERS, type About, type Layer, type Row } from "./rows";
import { svg } from "./svg";

const MOST_MOMENTS = 400;
const MOST_ROWS = 6000;

/** Half the width of the slider's thumb in px: its middle stands at a time. */
const EDGE = 12;

export interface Moment { about: About; picture: Blob; rows: number }

/** Outcome of a packet: decoded and all codewords, and the part of the bits that was wrong: null if no codeword was decoded, undefined without soft values. */
export interface Mark { id: number; time_s: number; distance_m: number; layers: Record<Layer, { ok: number; all: number; wrong: number | null | undefined }> }

/** Times of a run, from the first frame to the last, as far as known. */
export interface Span { from_s: number; to_s: number }

/** Moments in order; if there are too many, every second one of the older half is dropped. */
export class Timeline {
  readonly moments: Moment[] = [];
  readonly marks: Mark[] = [];
  private rows: Row[] = [];
  private dropped = 0;
  private light: Extract<Row, { event: "light" }> | null = null;

  row(row: Row): void {
    if (row.event === "light") this.light = row;
    if (row.event === "packet") this.mark(row);
    this.rows.push(row);
    if (this.rows.length > MOST_ROWS) {
      // counts stand in the newest rows; the dropped rows are packets and soft values long past
      const keep = this.rows.filter((one, k) => k > MOST_ROWS / 2 || ["source", "message", "file"].includes(one.event));
      this.dropped += this.rows.length - keep.length;
      this.rows = keep;
      this.marks.splice(0, this.marks.length - MOST_ROWS);
    }
  }

  private mark(row: Extract<Row, { event: "packet" }>): void {
    const soft = this.light?.id === row.id && this.light.time_s === row.time_s ? this.light.layers : undefined;
    const layers = LAYERS.map((layer) => {
      const words = row.layers[layer] ?? [];
      const bits = soft?.[layer];
      const wrong = bits === undefined ? undefined : bits.known === 0 ? null : bits.wrong / bits.known;
      return [layer, { ok: words.filter((word) => word.status === "ok").length, all: words.length, wrong }];
    });
    this.marks.push({ id: row.id, time_s: row.time_s, distance_m: row.distance_m, layers: Object.fromEntries(layers) as Mark["layers"] });
  }

  moment(about: About, picture: Blob): void {
    this.moments.push({ about, picture, rows: this.rows.length + this.dropped });
    if (this.moments.length > MOST_MOMENTS) {
      const half = MOST_MOMENTS / 2;
      // the first moment stays
      this.moments.splice(0, half, ...this.moments.slice(0, half).filter((_, k) => k % 2 === 0));
    }
  }

  /** The kept moment nearest to a time. */
  nearest(time_s: number): Moment | undefined {
    const distance = (moment: Moment): number => Math.abs(moment.about.time_s - time_s);
    return this.moments.reduce<Moment | undefined>((best, moment) => best === undefined || distance(moment) <= distance(best) ? moment : best, undefined);
  }

  /** The moment some places after another one. */
  after(moment: Moment | null, places: number): Moment | undefined {
    const place = moment === null ? this.moments.length - 1 : this.moments.indexOf(moment);
    return this.moments[Math.min(Math.max(place + places, 0), this.moments.length - 1)];
  }

  span(model: Model): Span {
    const from_s = this.moments[0]?.about.time_s ?? 0;
    const newest_s = this.moments.at(-1)?.about.time_s ?? 0;
    const source = model.source;
    return { from_s, to_s: Math.max(newest_s, from_s + 0.001, source?.frames ? from_s + source.frames / source.rate_hz : 0) };
  }

  /** The page as it was at a moment. */
  modelAt(moment: Moment): Model {
    const model = empty();
    for (const row of this.rows.slice(0, Math.max(1, moment.rows - this.dropped))) apply(model, row);
    return model;
  }

  /** Draws the marks: three rows by layer, each divided by array, with distances above. */
  draw({ from_s, to_s }: Span, packet_s: number): void {
    const place = one("ticks", SVGSVGElement);
    const [width, height] = [place.clientWidth, place.clientHeight];
    if (width === 0) return;
    const [top, step] = [16, (height - 16) / LAYERS.length];
    const x = (time_s: number): number => EDGE + ((time_s - from_s) / (to_s - from_s)) * (width - 2 * EDGE);
    const arrays = [...new Set(this.marks.map((mark) => mark.id))].sort((a, b) => a - b); // their packets overlap
    const full = Math.max(2, (step - 3) / Math.max(1, arrays.length) - (arrays.length > 1 ? 1 : 0));
    const wide = Math.max(1.5, x(from_s + packet_s) - x(from_s) - 1);
    let label = -Infinity;
    place.setAttribute("viewBox", `0 0 ${width} ${height}`);
    place.setAttribute("aria-label", `${this.marks.length} packets: ${LAYERS.map((layer) => {
      const [ok, all] = (["ok", "all"] as const).map((part) => this.marks.reduce((sum, mark) => sum + mark.layers[layer][part], 0));
      return `${layer} layer ${ok} of ${all} codewords decoded`;
    }).join(", ")}`);
    const ends = LAYERS.map((_, k) => svg("line", { x1: EDGE, x2: width - EDGE, y1: top + (k + 1) * step - 1, y2: top + (k + 1) * step - 1, class: "axis" }));
    place.replaceChildren(...ends, ...this.marks.flatMap((mark) => {
      const parts: Node[] = LAYERS.map((layer, k) => {
        const { ok, all } = mark.layers[layer];
        const tall = all > 0 && ok === all ? full : ok > 0 ? full / 2 : Math.min(2, full / 3);
        const base = top + (k + 1) * step - 1 - (arrays.length - 1 - arrays.indexOf(mark.id)) * (full + 1);
        return svg("rect", { x: x(mark.time_s), y: base - tall, width: wide, height: tall, class: `bar ${layer}` });
      });
      if (x(mark.time_s) > label + 48 && x(mark.time_s) < width - 30) {
        label = x(mark.time_s);
        parts.push(svg("text", { x: label, y: 11, class: "tick" }, `${mark.distance_m.toFixed(0)} m`));
      }
      return parts;
    }));
  }

  clear(): void {
    this.moments.length = this.marks.length = 0;
    this.rows = [];
    this.dropped = 0;
    this.light = null;
  }
}
