/** Asks what the cards show of the surface on screen, once it is final and nothing is changed for a moment. */

import type { Question } from "../protocol/types";
import type { DueQuestion } from "../state/answers";

/** The server's own rest begins 250 ms after the surface is done: answers are there before a better one is made. */
const REST_MS = 150;

export class Asker {
  private timer: ReturnType<typeof setTimeout> | undefined;
  /** What was asked and not answered, by type: the view that it is about. */
  private readonly asked = new Map<Question["type"], string>();
  private waitsFor = "";

  constructor(
    private readonly allDue: () => readonly DueQuestion[],
    private readonly ask: (question: Question) => void,
  ) {}

  /** Something changed: questions that are due are asked after a short delay, which starts again if they change meanwhile. */
  follow(): void {
    const due = this.due();
    const waitsFor = due.map(({ question, key }) => question.type + key).join();
    if (waitsFor === this.waitsFor && this.timer !== undefined) return;
    clearTimeout(this.timer);
    this.waitsFor = waitsFor;
    this.timer = due.length === 0 ? undefined : setTimeout(() => this.askDue(), REST_MS);
  }

  /** An answer is there, or was dropped because it came too late: what is still due is asked again. */
  answered(type: Question["type"]): void {
    this.asked.delete(type);
  }

  /** An edit was sent: it drops an annotation that is not made yet. */
  edited(): void {
    this.asked.delete("annotate");
  }

  /** The server knows of no question any more. */
  reset(): void {
    this.asked.clear();
  }

  private due() {
    return this.allDue().filter(({ question, key }) => this.asked.get(question.type) !== key);
  }

  private askDue(): void {
    this.timer = undefined;
    for (const { question, key } of this.due()) {
      this.asked.set(question.type, key);
      this.ask(question);
    }
  }
}
