import "../common/style.css";
import "./transmit.css";
import "../common/page";
import { ask, save } from "../common/api";
import { bytes, make, one } from "../common/dom";
import { Notice } from "../common/notice";
import { drawChart } from "./chart";
import { Packets, type Facts } from "./packets";
import { Player, type Light } from "./player";
import { divisors, measured } from "./refresh";

const form = one("form", HTMLFormElement);
const text = one("text", HTMLTextAreaElement);
const file = one("file", HTMLInputElement);
const side = one("side", HTMLSelectElement);
const rate = one("rate", HTMLSelectElement);
const gamma = one("gamma", HTMLInputElement);
const brightness = one("brightness", HTMLInputElement);
const stage = one("stage", HTMLElement);
const array = one("array", HTMLCanvasElement);
const chart = one("chart", HTMLCanvasElement);
const pauseButton = one("pause", HTMLButtonElement);
const said = one("said", HTMLElement);
const notice = new Notice(one("notices", HTMLElement));

/** Rate that is chosen first: each pattern is then in three frames of a phone's 30 a second. */
const FIRST_HZ = 10;

/** Length of a video that is saved in s, at least. */
const FILM_S = 30;

let player: Player | null = null;
let facts: Facts | null = null;
let packets: Packets | null = null;
let refresh = 60;
let awake: WakeLockSentinel | null = null;

function light(): Light {
  return { gamma: Number(gamma.value), brightness: Number(brightness.value) / 100 };
}

function show(label: string, value: string): HTMLTableRowElement {
  return make("tr", {}, make("th", { scope: "row" }, label), make("td", {}, value));
}

function seconds(count: number): string {
  return count < 90 ? `${count.toFixed(count < 10 ? 1 : 0)} s` : `${(count / 60).toFixed(1)} min`;
}

function showFacts(): void {
  const rows = [show("Display", `${refresh.toFixed(refresh % 1 ? 2 : 0)} refreshes a second`)];
  if (facts !== null) {
    rows.push(
      show("Sent", `${bytes(facts.bytes)} ${facts.as_file ? "as a file: any packets will do" : "as a message"}`),
      show("A packet", `${seconds(facts.packet_s)}, ${facts.packet_bytes} bytes: ${Math.round(facts.bits_per_s)} bit/s`),
      show("All of it", `${facts.packets} ${facts.packets === 1 ? "packet" : "packets"}: ${seconds(facts.seconds)}, if all are read`),
    );
  }
  if (player !== null && facts !== null) {
    const { skipped, refreshes, lost } = player;
    const part = refreshes > 0 ? (100 * skipped) / refreshes : 0;
    rows.push(show("Refreshes skipped", `${skipped} (${part.toFixed(part < 10 ? 1 : 0)} %)`), show("Patterns never shown", String(lost)));
    rows.at(-1)?.setAttribute("data-lost", String(lost));
  }
  one("facts", HTMLElement).replaceChildren(...rows);
  if (packets?.failed) notice.fail(packets.failed);
  else showSkipped();
}

function showSkipped(): void {
  if (player === null || player.lost < 3) return;
  notice.say(`This display skips refreshes: ${player.lost} patterns were never shown. Choose a lower rate, or close other programs.`);
}

function advise(): void {
  const hz = refresh / Number(rate.value);
  const film = hz <= 16 ? "30" : hz <= 31 ? "60" : "240";
  const least = hz <= 3 ? "For slow displays and remote desktops: a packet takes long. " : "";
  one("advice", HTMLElement).textContent =
    `${least}Film at ${film} frames a second${film === "30" ? ", as phones do by themselves" : ""}.`;
}

async function content(): Promise<{ data: Blob; name: string | null }> {
  if (form.elements.namedItem("kind") instanceof RadioNodeList && (form.elements.namedItem("kind") as RadioNodeList).value === "text") {
    return { data: new Blob([text.value]), name: null };
  }
  const chosen = file.files?.[0];
  if (chosen === undefined) throw new Error("Choose a file first.");
  return { data: chosen, name: chosen.name };
}

async function send(): Promise<void> {
  notice.clear();
  const { data, name } = await content();
  const lasts = Number(rate.value);
  const query = new URLSearchParams({ side: side.value, rate_hz: String(refresh / lasts), ...(name === null ? {} : { name }) });
  const answer = await ask(`transmit?${query}`, { method: "POST", body: data });
  facts = (await answer.json()) as Facts;
  packets = new Packets(facts);
  await packets.begin();
  player ??= new Player(array, 1000 / refresh, lasts, light());
  player.onChange = showFacts;
  player.play(packets, lasts);
  player.setLight(light());
  player.fit();
  for (const id of ["pause", "full", "again", "film"]) one(id, HTMLButtonElement).disabled = false;
  array.setAttribute("aria-label", `Patterns of ${facts.side} × ${facts.side} cells, ${facts.rate_hz.toFixed(1)} a second`);
  said.textContent = "Sending.";
  showPaused();
  showFacts();
  await stayAwake();
}

async function stayAwake(): Promise<void> {
  try {
    awake ??= await navigator.wakeLock.request("screen");
    awake.onrelease = () => { awake = null; };
  } catch {
    // not offered, or not now: the display may go dark by itself
  }
}

function showPaused(): void {
  pauseButton.textContent = player?.paused ? "Go on" : "Pause";
}

function togglePause(): void {
  if (player === null) return;
  player.pause(!player.paused);
  said.textContent = player.paused ? "Paused." : "Sending.";
  showPaused();
}

async function toggleFull(): Promise<void> {
  if (stage.classList.contains("fills")) stage.classList.remove("fills");
  else if (document.fullscreenElement === null) {
    try {
      await stage.requestFullscreen({ navigationUI: "hide" });
    } catch {
      stage.classList.add("fills"); // phones of one maker have no full screen for pages
    }
  } else {
    await document.exitFullscreen();
  }
  player?.fit();
}

function typed(event: KeyboardEvent): void {
  const there = event.target;
  const typing = there instanceof HTMLTextAreaElement || there instanceof HTMLInputElement || there instanceof HTMLSelectElement;
  if (event.ctrlKey || event.metaKey || event.altKey || player === null) return;
  if (event.key === "Escape") stage.classList.remove("fills");
  if (typing || (event.key === " " && there instanceof HTMLButtonElement)) return;
  if (event.key === " ") {
    event.preventDefault();
    togglePause();
  } else if (event.key === "f" || event.key === "F") {
    void toggleFull();
  }
}

async function saveFilm(): Promise<void> {
  if (facts === null) return;
  notice.say("The video is being made …");
  const length = Math.min(600, Math.max(FILM_S, 1.5 * facts.seconds));
  const answer = await ask(`transmit/${facts.sending}/film?seconds=${length}&gamma=${gamma.value}`);
  save(await answer.blob(), "patterns.mp4");
  notice.say(`Play patterns.mp4 (${seconds(length)}) in a loop, full screen, on any display, and film it.`);
}

function lit(): void {
  one("gamma-said", HTMLElement).textContent = Number(gamma.value).toFixed(2);
  one("brightness-said", HTMLElement).textContent = `${brightness.value} %`;
  drawChart(chart, Number(gamma.value));
  player?.setLight(light());
}

function chooseKind(): void {
  const isText = (form.elements.namedItem("kind") as RadioNodeList).value === "text";
  one("text-part", HTMLElement).hidden = !isText;
  one("file-part", HTMLElement).hidden = isText;
}

async function prepare(): Promise<void> {
  refresh = await measured();
  const rates = divisors(refresh);
  const first = rates.reduce((best, n) => (Math.abs(refresh / n - FIRST_HZ) < Math.abs(refresh / best - FIRST_HZ) ? n : best));
  rate.replaceChildren(...rates.map((n) => {
    const hz = refresh / n;
    return make("option", { value: n, selected: n === first }, `${hz.toFixed(Math.abs(hz - Math.round(hz)) > 0.005 ? 1 : 0)}`);
  }));
  advise();
  showFacts();
}

form.addEventListener("submit", (event) => {
  event.preventDefault();
  send().catch((error: unknown) => notice.fail(error));
});
form.addEventListener("change", chooseKind);
rate.addEventListener("change", advise);
gamma.addEventListener("input", lit);
brightness.addEventListener("input", lit);
pauseButton.addEventListener("click", togglePause);
one("full", HTMLButtonElement).addEventListener("click", () => void toggleFull());
one("again", HTMLButtonElement).addEventListener("click", () => { player?.restart(); showPaused(); });
one("film", HTMLButtonElement).addEventListener("click", () => void saveFilm().catch((error: unknown) => notice.fail(error)));
stage.addEventListener("dblclick", () => void toggleFull());
document.addEventListener("keydown", typed);
document.addEventListener("fullscreenchange", () => player?.fit());
document.addEventListener("visibilitychange", () => {
  if (document.visibilityState === "visible" && player !== null) void stayAwake();
});
new ResizeObserver(() => player?.fit()).observe(stage);
setInterval(showFacts, 1000);
lit();
chooseKind();
void prepare();
