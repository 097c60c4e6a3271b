// Small gray pictures: cut-outs and patterns.

import { one } from "../common/dom";
import type { Grey } from "./rows";

export function imageOf(grey: Grey): ImageData {
  const image = new ImageData(grey.columns, grey.rows);
  const levels = atob(grey.data);
  for (let k = 0; k < levels.length; k += 1) {
    image.data.fill(levels.charCodeAt(k), 4 * k, 4 * k + 3);
    image.data[4 * k + 3] = 255;
  }
  return image;
}

export function drawGrey(id: string, grey: Grey | undefined, name: string): void {
  const canvas = one(id, HTMLCanvasElement);
  const context = canvas.getContext("2d");
  if (context === null) return;
  if (grey === undefined) {
    context.clearRect(0, 0, canvas.width, canvas.height);
    canvas.setAttribute("aria-label", `${name}: not known`);
    return;
  }
  canvas.width = grey.columns;
  canvas.height = grey.rows;
  context.putImageData(imageOf(grey), 0, 0);
  canvas.setAttribute("aria-label", `${name}: ${grey.columns} by ${grey.rows} levels`);
}
