// The state of the page in its address, so that Reload and Back restore source and moment.

import type { Source } from "./link";

export interface State { source: Source; frame: number | null }

const TEXTS = ["film", "preset", "receiver"] as const;
const NUMBERS = ["number", "seed", "distance_m", "rate_hz"] as const;

export function stateOf(hash: string): State | null {
  const given = new URLSearchParams(hash.replace(/^#/, ""));
  const kind = given.get("kind");
  if (kind === null) return null;
  const source: Source = { kind };
  for (const name of TEXTS) {
    const value = given.get(name);
    if (value !== null) source[name] = value;
  }
  for (const name of NUMBERS) {
    const value = given.get(name);
    if (value !== null) source[name] = Number(value);
  }
  if (given.has("street")) source.street = given.get("street") === "true";
  if (given.has("changes")) source.changes = given.getAll("changes");
  const frame = Number(given.get("frame"));
  return { source, frame: Number.isInteger(frame) && frame > 0 ? frame : null };
}

export function hashOf({ source, frame }: State): string {
  const { changes, ...rest } = source;
  const all = new URLSearchParams(Object.entries(rest).map(([name, value]) => [name, String(value)]));
  for (const change of changes ?? []) all.append("changes", change);
  if (frame !== null) all.set("frame", String(frame));
  return `#${all}`;
}
