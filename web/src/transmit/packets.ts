// Packets of patterns from the server, fetched shortly before they are shown; those that were shown are forgotten.

import { ask } from "../common/api";

/** What the server tells of what is sent. */
export interface Facts {
  sending: string;
  side: number;
  rate_hz: number;
  packet_patterns: number;
  packet_s: number;
  bytes: number;
  as_file: boolean;
  packet_bytes: number;
  packets: number;
  seconds: number;
  bits_per_s: number;
}

/** Seconds of patterns that are there before they are shown. */
const AHEAD_S = 6;

/** Time in ms from a request that failed to the next one. */
const AGAIN_MS = 1000;

/** Packets that are asked for at once. */
const MOST = 16;

export class Packets {
  private readonly held = new Map<number, Uint8Array>();
  private asking = false;
  private notBefore = 0;
  private readonly ahead: number;
  /** What went wrong with the last request; the next one that succeeds clears it. */
  failed: unknown = null;

  constructor(readonly facts: Facts) {
    this.ahead = Math.max(2, Math.ceil(AHEAD_S / facts.packet_s));
  }

  /** Levels 0 to 4 of a pattern, row by row; null where they are not there yet. */
  levels(pattern: number): Uint8Array | null {
    const { packet_patterns: length, side } = this.facts;
    const packet = Math.floor(pattern / length);
    const held = this.held.get(packet);
    this.fill(packet);
    const from = (pattern - packet * length) * side * side;
    return held === undefined ? null : held.subarray(from, from + side * side);
  }

  /** Waits for the first packets. */
  async begin(): Promise<void> {
    await this.fetch(0, 2);
  }

  private fill(packet: number): void {
    for (const old of this.held.keys()) if (old < packet) this.held.delete(old);
    if (this.asking || performance.now() < this.notBefore) return;
    let first = packet;
    while (this.held.has(first)) first += 1;
    const count = Math.min(MOST, packet + this.ahead + 1 - first);
    if (count <= 0) return;
    this.fetch(first, count).catch((error: unknown) => {
      this.failed = error;
      this.notBefore = performance.now() + AGAIN_MS;
    });
  }

  private async fetch(first: number, count: number): Promise<void> {
    this.asking = true;
    try {
      const answer = await ask(`transmit/${this.facts.sending}/packets?first=${first}&count=${count}`);
      const data = new Uint8Array(await answer.arrayBuffer());
      const size = this.facts.packet_patterns * this.facts.side ** 2;
      for (let k = 0; k < count; k += 1) this.held.set(first + k, data.slice(k * size, (k + 1) * size));
      this.failed = null;
    } finally {
      this.asking = false;
    }
  }
}
