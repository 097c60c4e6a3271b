// A junction's traffic lights, counted down between messages, and its lanes.

import { make, one } from "../common/dom";
import type { Model } from "./model";
import type { Group, Junction } from "./rows";
import { drawing, svg } from "./svg";

const LAMPS: readonly (readonly [string, readonly string[]])[] = [
  ["red", ["red", "red-yellow"]],
  ["yellow", ["yellow", "red-yellow", "flashing"]],
  ["green", ["green", "green-free"]],
];

function leftWords(group: Group, later_s: number): string {
  return group.left_s === null ? "" : `${Math.max(0, group.left_s - later_s).toFixed(1)} s`;
}

function lightHead(group: Group, later_s: number): HTMLElement {
  const lamps = LAMPS.map(([lamp, phases], k) =>
    svg("circle", { cx: 14, cy: 14 + 24 * k, r: 10, class: phases.includes(group.phase) ? `lamp ${lamp}` : "lamp off" }));
  const name = `Group ${group.group}: ${group.phase} ${leftWords(group, later_s)}`;
  return make("div", { class: "head" },
    drawing(28, 76, name, svg("rect", { width: 28, height: 76, rx: 6, class: "housing" }), ...lamps),
    make("div", {}, make("strong", {}, leftWords(group, later_s) || "–"), make("br"), `group ${group.group}`, make("br"), group.phase));
}

function plan(junction: Junction, groups: Map<number, Group>): SVGElement | null {
  const lanes = (junction.lanes ?? []).filter((lane) => lane.points_m.length > 1);
  const points = lanes.flatMap((lane) => lane.points_m);
  if (points.length === 0) return null;
  const reach = Math.max(...points.map(([x, y]) => Math.max(Math.abs(x), Math.abs(y)))) * 1.05;
  const scale = 100 / reach;
  // north is up
  const at = ([x, y]: [number, number]): string => `${(100 + x * scale).toFixed(1)},${(100 - y * scale).toFixed(1)}`;
  const wide = (junction.lane_width_m ?? 3) * scale;
  const roads = lanes.map((lane) => svg("polyline", {
    points: lane.points_m.map(at).join(" "), class: lane.kind === "crosswalk" ? "lane crosswalk" : "lane", "stroke-width": wide,
  }));
  const lights = lanes.flatMap((lane) => {
    const group = lane.groups.map((number) => groups.get(number)).find((found) => found !== undefined);
    if (group === undefined) return [];
    const [cx, cy] = at(lane.points_m[0]!).split(",") as [string, string];
    const phase = LAMPS.find(([, phases]) => phases.includes(group.phase))?.[0] ?? "off";
    return [svg("polyline", { points: lane.points_m.map(at).join(" "), class: `way ${phase}` }), svg("circle", { cx, cy, r: 5, class: `lamp ${phase}` })];
  });
  return drawing(200, 200, `Lanes of junction ${junction.name ?? junction.id} from above, north up`, ...roads, ...lights);
}

/** Draws what the lights show at a time of the film. */
export function drawLights(model: Model, now_s: number | null): void {
  const place = one("lights", HTMLElement);
  const row = model.lights;
  if (row === null && model.maps.size === 0) {
    if (place.dataset["shown"] !== undefined) place.replaceChildren(make("p", { class: "dim" }, "No traffic-light message yet."));
    delete place.dataset["shown"];
    return;
  }
  const later_s = row === null || now_s === null ? 0 : Math.max(0, now_s - row.time_s);
  const key = `${row?.time_s} ${later_s.toFixed(1)} ${model.maps.size}`;
  if (place.dataset["shown"] === key) return;
  place.dataset["shown"] = key;
  const told = new Map(row?.junctions.map((junction) => [junction.id, junction.groups]));
  const ids = [...new Set([...told.keys(), ...model.maps.keys()])];
  place.replaceChildren(...ids.map((id) => {
    const groups = told.get(id) ?? [];
    const junction = model.maps.get(id);
    const drawn = junction === undefined ? null : plan(junction, new Map(groups.map((group) => [group.group, group])));
    return make("div", { class: "junction" },
      make("h3", {}, `Junction ${id}${junction?.name ? `, ${junction.name}` : ""}`),
      make("div", { class: "heads" }, ...groups.map((group) => lightHead(group, later_s)),
        drawn ?? make("p", { class: "dim small" }, "The map arrives in the middle layer.")));
  }));
}
