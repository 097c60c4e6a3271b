// What was shown, kept to be shown again: a bounded number of moments, and the rows between them.

import { apply, empty, type Model } from "./model";
import type { About, Row } from "./rows";

const MOST_MOMENTS = 400;
const MOST_ROWS = 6000;

export interface Moment { about: About; picture: Blob; rows: number }

/** Moments in order; where there are too many, every second of the older half is let go. */
export class Timeline {
  readonly moments: Moment[] = [];
  private rows: Row[] = [];
  private dropped = 0;

  row(row: Row): void {
    this.rows.push(row);
    if (this.rows.length > MOST_ROWS) {
      // counts stand in the newest rows; what is let go are packets and soft values long past
      const keep = this.rows.filter((one, k) => k > MOST_ROWS / 2 || ["source", "message", "file"].includes(one.event));
      this.dropped += this.rows.length - keep.length;
      this.rows = keep;
    }
  }

  moment(about: About, picture: Blob): void {
    this.moments.push({ about, picture, rows: this.rows.length + this.dropped });
    if (this.moments.length > MOST_MOMENTS) {
      const half = MOST_MOMENTS / 2;
      this.moments.splice(0, half, ...this.moments.slice(0, half).filter((_, k) => k % 2 === 0));
    }
  }

  /** The page as it was at a moment. */
  modelAt(moment: Moment): Model {
    const model = empty();
    for (const row of this.rows.slice(0, Math.max(1, moment.rows - this.dropped))) apply(model, row);
    return model;
  }

  clear(): void {
    this.moments.length = 0;
    this.rows = [];
    this.dropped = 0;
  }
}
