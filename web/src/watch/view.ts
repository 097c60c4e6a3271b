// The part of the frame that is shown: zoom and pan by wheel, fingers, buttons and keys.

const MAX_ZOOM = 16;

type Point = readonly [number, number];

/** Zoom and centre, in parts of the image, so that a source of another size keeps them. */
export class View {
  zoom = 1;
  private centre: Point = [0.5, 0.5];
  private image: Point = [16, 9];
  private readonly fingers = new Map<number, Point>();

  constructor(private readonly box: HTMLElement, private readonly changed: () => void) {
    box.addEventListener("wheel", (event) => {
      if (event.deltaY > 0 && this.zoom === 1) return; // the page scrolls
      event.preventDefault();
      this.zoomBy(2 ** (-event.deltaY / 240), this.inside(event));
    }, { passive: false });
    box.addEventListener("pointerdown", (event) => {
      this.fingers.set(event.pointerId, this.inside(event));
      if (this.zoom > 1) box.setPointerCapture(event.pointerId);
    });
    box.addEventListener("pointermove", (event) => this.drag(event));
    for (const name of ["pointerup", "pointercancel", "pointerleave"] as const) {
      box.addEventListener(name, (event) => this.fingers.delete(event.pointerId));
    }
  }

  private inside(event: MouseEvent): Point {
    const place = this.box.getBoundingClientRect();
    return [event.clientX - place.left, event.clientY - place.top];
  }

  private drag(event: PointerEvent): void {
    const before = this.fingers.get(event.pointerId);
    if (before === undefined) return;
    const now = this.inside(event);
    const other = [...this.fingers].find(([id]) => id !== event.pointerId)?.[1];
    this.fingers.set(event.pointerId, now);
    if (other !== undefined) {
      const length = (point: Point): number => Math.max(1, Math.hypot(point[0] - other[0], point[1] - other[1]));
      this.zoomBy(length(now) / length(before), [(now[0] + other[0]) / 2, (now[1] + other[1]) / 2]);
    } else this.moveBy(before[0] - now[0], before[1] - now[1]);
  }

  /** Pixels of the screen for a pixel of the image. */
  get scale(): number {
    return this.zoom * Math.min(this.box.clientWidth / this.image[0], this.box.clientHeight / this.image[1]);
  }

  /** Where the image's first pixel is on the screen. */
  get origin(): Point {
    return [this.box.clientWidth / 2 - this.centre[0] * this.image[0] * this.scale, this.box.clientHeight / 2 - this.centre[1] * this.image[1] * this.scale];
  }

  fit(width: number, height: number): void {
    this.image = [width, height];
    this.moveTo(this.centre);
  }

  zoomBy(factor: number, at: Point = [this.box.clientWidth / 2, this.box.clientHeight / 2]): void {
    const before = this.scale;
    this.zoom = Math.min(MAX_ZOOM, Math.max(1, this.zoom * factor));
    this.box.style.touchAction = this.zoom > 1 ? "none" : "pan-y";
    // the point of the image below the pointer stays there
    const step = 1 / before - 1 / this.scale;
    this.moveTo([this.centre[0] + ((at[0] - this.box.clientWidth / 2) * step) / this.image[0], this.centre[1] + ((at[1] - this.box.clientHeight / 2) * step) / this.image[1]]);
  }

  moveBy(x: number, y: number): void {
    this.moveTo([this.centre[0] + x / this.scale / this.image[0], this.centre[1] + y / this.scale / this.image[1]]);
  }

  reset(): void {
    this.zoomBy(0);
  }

  private moveTo(centre: Point): void {
    const within = (value: number, shown: number): number => shown >= 1 ? 0.5 : Math.min(1 - shown / 2, Math.max(shown / 2, value));
    this.centre = [
      within(centre[0], this.box.clientWidth / this.scale / this.image[0]),
      within(centre[1], this.box.clientHeight / this.scale / this.image[1]),
    ];
    this.changed();
  }
}
