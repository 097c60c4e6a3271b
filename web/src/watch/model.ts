// All that a page shows at a moment, made of the rows up to it; the same rows give the same page.

import type { ArrayCounts, Bin, Junction, Row } from "./rows";

type Of<E extends Row["event"]> = Extract<Row, { event: E }>;

const MOST_LISTED = 60;

/** A picture, and the packet that completed it first. */
export interface Picture { data: string; bytes: number; count: number; packet: Of<"packet"> | undefined }

export interface Model {
  source: Of<"source"> | null;
  packets: Of<"packet">[];
  messages: Of<"message">[];
  unfinished: Of<"unfinished">["messages"];
  files: Map<string, Of<"file">>;
  approach: Map<number, number | null>;
  light: Of<"light"> | null;
  lights: Of<"lights"> | null;
  maps: Map<number, Junction>;
  picture: Picture | null;
  pictures: Map<string, Picture>;
  arrays: ArrayCounts[];
  errors: Bin[] | null;
  falseCodewords: number;
  state: Of<"state"> | null;
}

export function empty(): Model {
  return {
    source: null, packets: [], messages: [], unfinished: [], files: new Map(), approach: new Map(), light: null,
    lights: null, maps: new Map(), picture: null, pictures: new Map(), arrays: [], errors: null, falseCodewords: 0, state: null,
  };
}

/** Base64 of PNG, JPEG or RIFF (WebP) begins so. */
const PICTURES: readonly (readonly [string, string])[] = [["iVBORw0K", "image/png"], ["/9j/", "image/jpeg"], ["UklGR", "image/webp"]];

export function pictureType(data: string | undefined): string | null {
  return PICTURES.find(([begin]) => data?.startsWith(begin))?.[1] ?? null;
}

function kept<T>(list: T[], one: T): void {
  list.unshift(one);
  if (list.length > MOST_LISTED) list.length = MOST_LISTED;
}

function message(model: Model, row: Of<"message">): void {
  const old = model.messages.findIndex((one) => one.id === row.id && one.layer === row.layer && one.stream === row.stream && one.data === row.data);
  if (old >= 0) model.messages.splice(old, 1);
  kept(model.messages, row);
  if (row.road?.kind === "MAPEM") for (const junction of row.road.junctions) model.maps.set(junction.id, junction);
  if (row.data !== undefined && pictureType(row.data) !== null && row.bytes >= (model.picture?.bytes ?? 0)) {
    show(model, row, row.data);
  }
}

/** Shows a picture; a repeated picture keeps its first packet. */
function show(model: Model, { id, bytes }: { id: number; bytes: number }, data: string): void {
  model.picture = model.pictures.get(data) ?? { data, bytes, count: model.pictures.size + 1, packet: model.packets.find((one) => one.id === id) };
  model.pictures.set(data, model.picture);
}

/** Takes a row into the model; those of commands and of the end are no part of it. */
export function apply(model: Model, row: Row): void {
  switch (row.event) {
    case "source": model.source = row; break;
    case "packet": kept(model.packets, row); model.approach.set(row.id, row.approach_m_s); break;
    case "message": message(model, row); break;
    case "unfinished": model.unfinished = row.messages; break;
    case "file":
      model.files.set(row.file, row);
      if (row.whole && row.data !== undefined && pictureType(row.data) !== null) show(model, row, row.data);
      break;
    case "light": model.light = row; break;
    case "lights": model.lights = row; break;
    case "lost": model.approach.delete(row.id); break;
    case "state":
      model.state = row;
      model.arrays = row.arrays;
      model.errors = row.errors ?? null;
      model.falseCodewords = row.false_codewords ?? 0;
      break;
    default:
  }
}
