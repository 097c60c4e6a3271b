// Rows from the server during a reception: its journal and its progress.

import { socket } from "../common/api";

/** A row, by its `event`; see `measure.journal` and `web.reading` of the package. */
export type Row =
  | { event: "found" | "lost"; id: number; time_s: number }
  | { event: "packet"; id: number; time_s: number; layers: Record<string, { status: string }[]> }
  | { event: "message"; id: number; layer: string; stream: number; bytes: number; data: string; text?: string }
  | { event: "file"; id: number; file: string; bytes: number; symbols: number; needed: number; whole: boolean;
      reason?: string; name?: string; data?: string }
  | { event: "light"; rate_hz: number | null; side?: number | null }
  | { event: "trying"; side: number }
  | { event: "progress"; frames: number; of: number | null }
  | { event: "took"; frames: number; dropped: number }
  | { event: "no light" | "asking why" }
  | { event: "early"; lines: string[] }
  | { event: "why"; lines: string[]; bytes: number }
  | { event: "outline"; corners: number[] }
  | { event: "left"; frames: number }
  | { event: "saved" | "bundle"; bundle: string; bytes: number }
  | { event: "refused"; error: string }
  | { event: "error"; error: string }
  | { event: "end"; frames: number; packets: number; ok: number; failed: number; let_go: number };

/** Request of the page. */
export interface Wish {
  kind: "film" | "camera";
  film?: string;
  side: number | null;
  rate_hz: number | null;
}

/** Opens a reading; `take` gets its rows, `ended` is called once when it is over. */
export function reading(wish: Wish, take: (row: Row) => void, ended: (reason: string) => void): WebSocket {
  const made = socket("receive");
  let last = "";
  made.onopen = () => made.send(JSON.stringify(wish));
  made.onmessage = (message: MessageEvent<string>) => {
    const row = JSON.parse(message.data) as Row;
    if (row.event === "error") last = row.error;
    take(row);
  };
  made.onclose = (event) => ended(last || (event.code === 1000 ? "" : "the server closed the connection"));
  return made;
}

/** Bytes of Base64. */
export function unpacked(data: string): Uint8Array<ArrayBuffer> {
  return Uint8Array.from(atob(data), (one) => one.charCodeAt(0));
}
