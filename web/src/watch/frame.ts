// The frame with a box about each array that is followed.

import { colour, one } from "../common/dom";
import { imageOf } from "./grey";
import type { Model } from "./model";
import { arrayName, type About, type Box } from "./rows";

export function speedWords(approach: number | null | undefined): string {
  if (approach === null || approach === undefined) return "";
  const speed = Math.abs(approach * 3.6).toFixed(0);
  return speed === "0" ? "at rest" : `${speed} km/h ${approach >= 0 ? "nearing" : "receding"}`;
}

export class FrameView {
  private readonly canvas = one("frame", HTMLCanvasElement);
  private asked = 0;
  private drawn = 0;

  async draw(about: About, picture: Blob, model: Model): Promise<void> {
    const order = ++this.asked;
    const [image, ...cuts] = await Promise.all([
      createImageBitmap(picture), ...about.cuts.slice(0, 3).map((cut) => createImageBitmap(imageOf(cut.received))),
    ]);
    if (order < this.drawn) return; // a newer frame was decoded sooner
    this.drawn = order;
    const canvas = this.canvas;
    if (canvas.width !== image.width || canvas.height !== image.height) {
      canvas.width = image.width;
      canvas.height = image.height;
    }
    const context = canvas.getContext("2d");
    if (context === null) return;
    context.drawImage(image, 0, 0);
    image.close();
    cuts.forEach((cut, k) => this.inset(context, cut, k, arrayName(about.cuts[k] ?? { id: 0 })));
    const scale = canvas.width / about.width;
    for (const box of about.boxes) this.box(context, box, scale, model);
    canvas.setAttribute("aria-label", this.words(about, model));
  }

  /** The newest cut-out of an array, enlarged, at the frame's upper edge. */
  private inset(context: CanvasRenderingContext2D, cut: ImageBitmap, place: number, name: string): void {
    const size = Math.max(1, this.canvas.width / Math.max(this.canvas.clientWidth, 1));
    const side = Math.min(this.canvas.height * 0.3, 150 * size);
    const left = 8 * size + place * (side + 8 * size);
    context.imageSmoothingEnabled = false;
    context.drawImage(cut, left, 8 * size, side, side);
    cut.close();
    context.lineWidth = 2 * size;
    context.strokeStyle = "#ffb300";
    context.strokeRect(left, 8 * size, side, side);
    context.font = `600 ${12 * size}px system-ui, sans-serif`;
    context.fillStyle = "rgb(11 13 17 / 80%)";
    context.fillRect(left, 8 * size, context.measureText(name).width + 10 * size, 18 * size);
    context.fillStyle = "#fff";
    context.fillText(name, left + 5 * size, 21 * size);
  }

  private box(context: CanvasRenderingContext2D, box: Box, scale: number, model: Model): void {
    // where an image is shown smaller than it is, lines and letters are drawn larger
    const size = Math.max(1, this.canvas.width / Math.max(this.canvas.clientWidth, 1));
    const points = box.corners.map(([x, y]) => [(x + 0.5) * scale, (y + 0.5) * scale] as const);
    const [x, y] = [0, 1].map((k) => points.reduce((sum, point) => sum + (point[k as 0 | 1]), 0) / points.length) as [number, number];
    const grow = 1 + (6 * size) / Math.max(8, Math.hypot(points[0]![0] - x, points[0]![1] - y));
    context.lineWidth = 2 * size;
    context.strokeStyle = box.seen ? "#ffb300" : "#ff6e6e";
    context.setLineDash(box.seen ? [] : [6 * size, 4 * size]);
    context.beginPath();
    for (const [px, py] of points) context.lineTo(x + (px - x) * grow, y + (py - y) * grow);
    context.closePath();
    context.stroke();
    context.setLineDash([]);
    const lines = [arrayName(box), `${box.distance_m.toFixed(1)} m`, speedWords(model.approach.get(box.id))].filter((line) => line !== "");
    const text = lines.join(" · ");
    context.font = `600 ${14 * size}px system-ui, sans-serif`;
    const width = context.measureText(text).width;
    const bottom = Math.max(...points.map((point) => y + (point[1] - y) * grow)) + 8 * size;
    const top = bottom + 22 * size > this.canvas.height ? Math.min(...points.map((point) => y + (point[1] - y) * grow)) - 30 * size : bottom;
    const left = Math.min(Math.max(x - width / 2, 4 * size), Math.max(this.canvas.width - width - 4 * size, 0));
    context.fillStyle = "rgb(11 13 17 / 80%)";
    context.fillRect(left - 5 * size, top, width + 10 * size, 22 * size);
    context.fillStyle = "#fff";
    context.fillText(text, left, top + 16 * size);
  }

  private words(about: About, model: Model): string {
    const boxes = about.boxes.map((box) => `${arrayName(box)} ${box.seen ? "" : "out of sight "}at ${box.distance_m.toFixed(1)} m ${speedWords(model.approach.get(box.id))}`.trim());
    return `Frame ${about.frame} at ${about.time_s.toFixed(3)} s: ${boxes.join("; ") || "no array"}`;
  }

  clear(): void {
    this.drawn = ++this.asked;
    const context = this.canvas.getContext("2d");
    if (context === null) return;
    context.fillStyle = colour("screen");
    context.fillRect(0, 0, this.canvas.width, this.canvas.height);
    this.canvas.setAttribute("aria-label", "No frame yet");
  }
}
