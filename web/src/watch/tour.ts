// A guided tour of a recorded run, in five steps.

import { one } from "../common/dom";
import type { Moment, Timeline } from "./timeline";

interface Step { title: string; text: string; shows: string; moment: (timeline: Timeline) => Moment | undefined }

const STEPS: Step[] = [
  { title: "Pattern and inverse", shows: "frame-box",
    text: "Each pattern of the array is followed by its inverse. Their sum shows every LED, for tracking and without flicker; their difference carries the data. Step frame by frame to see both.",
    moment: ({ moments }) => moments.find((moment) => moment.about.cuts.length > 0) },
  { title: "Blur hides details of a distant array", shows: "frame-box",
    text: "Far away the LEDs melt into each other, so fine structures are lost first. As the car approaches, the enlarged array becomes sharp.",
    moment: ({ moments }) => moments[Math.floor(moments.length * 0.6)] },
  { title: "Three layers", shows: "ticks",
    text: "Urgent data use coarse structures, which can be read from afar: the high layer. The middle and low layers use finer ones: their first packets may fail, and a weaker receiver reads them only near the array.",
    moment: ({ moments }) => moments.at(-1) },
  { title: "How sure is a bit?", shows: "sure-title",
    text: "Before error correction each bit has a soft value. Two separate hills are clear bits, one hill is a guess; the turbo code corrects the guesses.",
    moment: ({ moments }) => moments[Math.floor(moments.length * 0.3)] },
  { title: "What arrived", shows: "arrived-title",
    text: "Decoded messages: traffic lights and texts, and a picture that sharpens with each packet of the low layer.",
    moment: ({ moments }) => moments.at(-1) },
];

export class Tour {
  private place = -1;

  constructor(private readonly timeline: Timeline, private readonly show: (moment: Moment | undefined) => void) {
    one("tour", HTMLElement).hidden = false;
    one("tour-next", HTMLButtonElement).onclick = () => this.go(this.place + 1);
    one("tour-back", HTMLButtonElement).onclick = () => this.go(this.place - 1);
    one("tour-end", HTMLButtonElement).onclick = () => this.go(STEPS.length);
    this.go(-1);
  }

  private go(place: number): void {
    this.place = place >= STEPS.length ? -1 : place;
    const step = STEPS[this.place];
    one("tour-next", HTMLButtonElement).textContent = step === undefined ? "Take the tour" : this.place === STEPS.length - 1 ? "Finish" : "Next";
    for (const id of ["tour-back", "tour-end"]) one(id, HTMLButtonElement).hidden = step === undefined;
    one("tour-back", HTMLButtonElement).disabled = this.place === 0;
    one("tour-title", HTMLElement).textContent = step === undefined ? "A recorded run: press Play, or drag the timeline." : `${this.place + 1} of ${STEPS.length}: ${step.title}`;
    one("tour-text", HTMLElement).textContent = step?.text ?? "";
    for (const shown of document.querySelectorAll(".toured")) shown.classList.remove("toured");
    if (step === undefined) return;
    this.show(step.moment(this.timeline));
    const shown = one(step.shows, Element).closest(".panel, .screen");
    shown?.classList.add("toured");
    shown?.scrollIntoView({ block: "nearest" });
  }
}
