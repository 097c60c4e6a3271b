// The WebSocket of a reception: commands go out, rows and scenes come in.

import { socket } from "../common/api";
import type { About, Row } from "./rows";

export interface Source {
  kind: string; film?: string; number?: number; preset?: string; seed?: number; street?: boolean;
  distance_m?: number; receiver?: string; rate_hz?: number; changes?: string[];
}

export interface Hearer {
  row(row: Row): void;
  scene(about: About, picture: Blob): Promise<void>;
  gone(reason: string): void;
}

/** A scene's message: the length of a text in 4 bytes, little end first; the text, JSON; the picture, JPEG. */
export function parted(data: ArrayBuffer): [About, Blob] {
  const length = new DataView(data).getUint32(0, true);
  const about = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length))) as About;
  return [about, new Blob([new Uint8Array(data, 4 + length)], { type: "image/jpeg" })];
}

/** A connection that lasts as long as a reception; a new one is opened with the next. */
export class Link {
  private socket: WebSocket | null = null;
  private rows = 0;
  private due = false;

  constructor(private readonly hearer: Hearer) {}

  /** Opens a source; with a frame, passes the frames up to that one at full speed and pauses. */
  open(source: Source, times: number | null, frame: number | null): void {
    this.close();
    const made = socket("watch");
    this.socket = made;
    this.rows = 0;
    made.onopen = () => {
      this.say({ do: "speed", times });
      this.say({ do: "open", source, paused: frame !== null });
      if (frame !== null) this.say({ do: "step", frames: frame + 1 });
    };
    made.onmessage = (event: MessageEvent<string | ArrayBuffer>) => {
      if (this.socket !== made) return;
      if (typeof event.data === "string") {
        this.hearer.row(JSON.parse(event.data) as Row);
        this.heard();
      }
      // the next scene comes when this one is drawn: a slow page gets fewer, never later ones
      else void this.hearer.scene(...parted(event.data)).finally(() => this.say({ do: "took" }));
    };
    made.onclose = (event) => {
      if (this.socket !== made) return;
      this.socket = null;
      this.hearer.gone(event.reason || (event.code === 1006 ? "the server has stopped: start it again and reload this page" : ""));
    };
  }

  /** Tells how many rows came: the server sends no more than so many ahead. */
  private heard(): void {
    this.rows += 1;
    if (this.due) return;
    this.due = true;
    setTimeout(() => {
      this.due = false;
      this.say({ do: "heard", rows: this.rows });
    }, 100);
  }

  /** True while the server hears commands. */
  get isOpen(): boolean {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  say(command: object): void {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(command));
  }

  close(): void {
    const old = this.socket;
    this.socket = null;
    old?.close();
  }
}
