// A recorded run in the page, without a server: all of it is known, and playing is looking at one moment after another.

import { parted } from "./link";
import type { About, Row } from "./rows";
import type { Moment, Timeline } from "./timeline";

type Entry = Row | { scene: string };

/** The run in the page; null on a page of a server. */
export function recordedRun(): Entry[] | null {
  const text = document.getElementById("run")?.textContent?.trim() ?? "";
  return text === "" || text === "RUN" ? null : JSON.parse(text) as Entry[];
}

export interface Stage {
  row(row: Row): void;
  keep(about: About, picture: Blob): void;
  lookAt(moment: Moment): Promise<void>;
  looking(): Moment | null;
  changed(): void;
}

export class Player {
  playing = false;
  private started = { ms: 0, time_s: 0 };

  constructor(run: Entry[], private readonly stage: Stage, private readonly timeline: Timeline, private readonly speed: () => number) {
    for (const entry of run) {
      if ("scene" in entry) stage.keep(...parted(Uint8Array.from(atob(entry.scene), (c) => c.charCodeAt(0)).buffer));
      else stage.row(entry);
    }
    this.show(timeline.moments[0]);
  }

  show(moment: Moment | undefined): void {
    if (moment !== undefined) void this.stage.lookAt(moment);
  }

  toggle(): void {
    this.playing = !this.playing;
    this.stage.changed();
    if (!this.playing) return;
    if (this.stage.looking() === this.timeline.moments.at(-1)) this.show(this.timeline.moments[0]);
    this.anchor();
    requestAnimationFrame(() => this.next());
  }

  /** Continues from the shown moment, also after a change of speed. */
  anchor(): void {
    const at = this.stage.looking() ?? this.timeline.moments[0];
    this.started = { ms: performance.now(), time_s: at?.about.time_s ?? 0 };
  }

  step(places: number): void {
    this.playing = false;
    this.show(this.timeline.after(this.stage.looking(), places));
  }

  /** Shows the moment at which the next packet has ended. */
  packet(packet_s: number): void {
    this.playing = false;
    const now_s = (this.stage.looking()?.about.time_s ?? 0) + 0.001;
    const next = this.timeline.marks.find((mark) => mark.time_s + packet_s > now_s);
    this.show(next === undefined ? this.timeline.moments.at(-1) : this.timeline.nearest(next.time_s + packet_s));
  }

  private next(): void {
    if (!this.playing) return;
    const time_s = this.started.time_s + (performance.now() - this.started.ms) / 1000 * this.speed();
    const moment = this.timeline.nearest(time_s);
    if (moment !== undefined && moment !== this.stage.looking()) this.show(moment);
    if (moment === this.timeline.moments.at(-1)) this.playing = false;
    this.stage.changed();
    requestAnimationFrame(() => this.next());
  }
}
