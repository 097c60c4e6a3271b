// A line that tells what happened or went wrong; a screen reader says it as it comes.

import { make } from "./dom";

/** A place for such a line: errors are said at once, all else when there is a pause. */
export class Notice {
  readonly element = make("p", { class: "notice", role: "status", "aria-live": "polite", hidden: true });

  constructor(before: Element) {
    before.before(this.element);
  }

  say(text: string): void {
    this.show(text, "status", "polite");
  }

  fail(error: unknown): void {
    const text = error instanceof Error ? error.message : String(error);
    // a sentence, unless it begins by a name
    this.show(/^[a-z]+ /.test(text) ? text.charAt(0).toUpperCase() + text.slice(1) : text, "alert", "assertive");
  }

  clear(): void {
    this.element.hidden = true;
    this.element.textContent = "";
  }

  private show(text: string, role: string, live: string): void {
    this.element.setAttribute("role", role);
    this.element.setAttribute("aria-live", live);
    this.element.classList.toggle("bad", role === "alert");
    this.element.hidden = false;
    this.element.textContent = text;
  }
}
