// The test chart by which the display's gamma is measured: half the light by stripes beside half the light by a gray.

import { pixel } from "./player";

/** Draws it: each stripe is a row of the display's pixels, full or black, so that the eye sees half the light. */
export function drawChart(canvas: HTMLCanvasElement, gamma: number): void {
  const context = canvas.getContext("2d", { alpha: false });
  if (context === null) return;
  const { width, height } = canvas;
  context.fillStyle = "#000";
  context.fillRect(0, 0, width, height);
  context.fillStyle = "#fff";
  for (let y = 0; y < height; y += 2) context.fillRect(0, y, width / 2, 1);
  const value = pixel(0.5, { gamma, brightness: 1 });
  context.fillStyle = `rgb(${value} ${value} ${value})`;
  context.fillRect(width / 2, 0, width / 2, height);
}
