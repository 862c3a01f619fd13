/** Asks the questions of the cards about the surface on screen, once it is final and the user pauses. */

import type { Question } from "../protocol/types";
import type { DueQuestion } from "../state/answers";

/** The server improves the surface 250 ms after it is done: answers arrive before that. */
const REST_MS = 150;

export class Asker {
  private timer: ReturnType<typeof setTimeout> | undefined;
  /** Unanswered questions by type, with the view that each is about. */
  private readonly asked = new Map<Question["type"], string>();
  private waitsFor = "";

  constructor(
    private readonly allDue: () => readonly DueQuestion[],
    private readonly ask: (question: Question) => void,
  ) {}

  /** Called on changes: questions that are due are asked after a short delay, which restarts if they change meanwhile. */
  follow(): void {
    const due = this.due();
    const waitsFor = due.map(({ question, key }) => question.type + key).join();
    if (waitsFor === this.waitsFor && this.timer !== undefined) return;
    clearTimeout(this.timer);
    this.waitsFor = waitsFor;
    this.timer = due.length === 0 ? undefined : setTimeout(() => this.askDue(), REST_MS);
  }

  /** An answer arrived, or was dropped because it came too late: questions that are still due are asked again. */
  answered(type: Question["type"]): void {
    this.asked.delete(type);
  }

  /** An edit was sent: it drops an annotation that is not made yet. */
  edited(): void {
    this.asked.delete("annotate");
  }

  /** The server has forgotten all questions. */
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
