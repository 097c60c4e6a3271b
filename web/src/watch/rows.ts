// What the server tells of a reception.

export type Layer = "high" | "middle" | "low";
export const LAYERS: readonly Layer[] = ["high", "middle", "low"];

/** Name of an array; a question mark until a codeword of the array is decoded. */
export function arrayName({ id, uncertain }: { id: number; uncertain?: boolean }): string {
  return `array ${id}${uncertain === true ? "?" : ""}`;
}

export interface Grey { rows: number; columns: number; data: string }
export interface Word { status: string; margin: number }
export interface Group { group: number; phase: string; left_s: number | null }
export interface Lane { lane: number; kind: string; points_m: [number, number][]; groups: number[] }
export interface Junction { id: number; name?: string | null; lane_width_m?: number | null; lanes?: Lane[]; groups?: Group[] }
export interface Tally { ok: number; failed: number; bytes: number }
export interface ArrayCounts { id: number; packets: number; layers: Record<Layer, Tally> }
export interface LeftOut { candidates: number; blocks: number }
export interface Bin { from_m: number; to_m: number; layers: Record<Layer, { wrong: number; sent: number; low: number; high: number }> }
export interface Histogram { scale: number; zeros: number[]; ones: number[]; open: number[]; known: number; wrong: number }

export type Row =
  | { event: "source"; name: string; width: number; height: number; rate_hz: number; frames: number | null; receiver: string; packet_s: number; live: boolean; truth: boolean; side: number }
  | { event: "found"; id: number; uncertain?: boolean; time_s: number; distance_m: number }
  | { event: "lost"; id: number; uncertain?: boolean; time_s: number; distance_m?: number; approach_m_s: number | null }
  | { event: "packet"; id: number; uncertain?: boolean; time_s: number; status: string; reason?: string; distance_m: number; approach_m_s: number | null; layers: Record<Layer, Word[]> }
  | { event: "light"; id: number; uncertain?: boolean; time_s: number; reason?: string; how?: string; pair?: number; pairs?: number; received?: Grey; equalised?: Grey; decided?: Grey; layers?: Record<Layer, Histogram> }
  | { event: "message"; id: number; layer: Layer; stream: number; bytes: number; data?: string; text?: string; road?: { kind: string; junctions: Junction[]; reason?: string } }
  | { event: "file"; id: number; file: string; bytes: number; symbols: number; needed: number; whole: boolean; name?: string; data?: string }
  | { event: "lights"; id: number; time_s: number; junctions: { id: number; groups: Group[] }[] }
  | { event: "unfinished"; messages: { id: number; layer: Layer; stream: number; had: number; bytes: number }[] }
  | { event: "state"; frames: number; time_s: number; seconds: number; paused: boolean; arrays: ArrayCounts[]; left_out: LeftOut; stages: Record<string, number>; failed: number; save_bytes: number; errors?: Bin[]; false_codewords?: number }
  | { event: "camera"; text: string }
  | { event: "saved"; bundle: string; bytes: number }
  | { event: "end"; stopped: boolean }
  | { event: "failed" | "refused"; reason: string };

export interface Box { id: number; uncertain?: boolean; seen: boolean; distance_m: number; corners: [number, number][] }
export interface About {
  time_s: number; frame: number; width: number; height: number; boxes: Box[];
  cuts: { id: number; uncertain?: boolean; received: Grey }[];
}
