/** What the server answered about the surface on screen, and what is worth asking. Pure. */

import type { ConnectionState } from "../net/connection";
import type { Curve, Distribution, Question, ServerMessage, Statistics, View } from "../protocol/types";
import { importanceOf } from "../protocol/view";
import type { Distances } from "./distances";

/** An answer, and what decided it: of another view it is another one. */
interface Answer<T> {
  readonly value: T;
  readonly key: string;
}

export interface Answers {
  readonly curve?: Answer<Curve>;
  readonly distribution?: Answer<Distribution>;
  /** Of the vertices, and the triangles around them, to the isosurface. */
  readonly annotate?: Answer<Distances>;
}

/** The parts of the viewer's state that decide which questions are asked. */
interface Asking {
  /** Number of the surface that all this is about. */
  readonly selected: number;
  readonly connection: ConnectionState;
  readonly sentView: View | undefined;
  readonly statistics: Statistics | undefined;
  readonly finished: number | undefined;
  readonly working: boolean;
  readonly questions: readonly string[];
  readonly answers: Answers;
}

/** Columns of the plot of the distribution. */
const BINS = 104;

type Asked = keyof Answers;

/** All that decides the curve: budgets and colours do not. */
function curveKey(view: View, isTreeCut: boolean): string {
  const { error: _e, triangles: _t, bytes: _b, beta: _β, transferFunction: _f, ...rest } = view;
  return JSON.stringify([rest, importanceOf(view), isTreeCut]);
}

/** What decides the answer for the surface on screen; `undefined` while there is none that is final. */
function keyOf(state: Asking, about: Asked): string | undefined {
  const { selected, sentView, statistics, finished, working, connection } = state;
  if (connection !== "connected" || working || finished === undefined || sentView === undefined) return undefined;
  if (statistics === undefined || statistics.triangles === 0) return undefined;
  if (about === "curve") return `${selected} ${curveKey(sentView, statistics.isTreeCut)}`;
  // Distances are measured after a better surface has come, if there is one.
  return about === "annotate" ? String(finished) : `${finished} ${statistics.isTreeCut}`;
}

/** An answer is about the surface of its generation: one that came too late is dropped. */
export function take(state: Asking, message: Curve | Distribution): Answers {
  const key = keyOf(state, message.type);
  if (key === undefined || message.generation !== state.finished) return state.answers;
  return { ...state.answers, [message.type]: { value: message, key } };
}

/** Distances of the surface of a generation. */
export function takeDistances(state: Asking, generation: number, value: Distances): Answers {
  const key = keyOf(state, "annotate");
  return key === String(generation) ? { ...state.answers, annotate: { value, key } } : state.answers;
}

/** Of the surface on screen; `undefined` while they are not known. */
export function measuredDistances(state: Asking): Distances | undefined {
  const { annotate } = state.answers;
  return annotate !== undefined && annotate.key === keyOf({ ...state, connection: "connected" }, "annotate") ? annotate.value : undefined;
}

/** Whether the distances of the surface on screen are on their way, or not to be had from this server. */
export function awaitedDistances(state: Asking): "measuring" | "unknown" | undefined {
  if (state.statistics === undefined || state.statistics.triangles === 0 || measuredDistances(state) !== undefined) return undefined;
  return state.questions.includes("annotate") ? "measuring" : "unknown";
}

export interface DueQuestion {
  readonly key: string;
  readonly question: Question;
}

/** What is not known of the selected surface on screen, of these and of all that the server answers. */
export function dueQuestions(state: Asking, about: readonly Asked[]): readonly DueQuestion[] {
  const surface = state.selected;
  const all: readonly Extract<Question, { type: Asked }>[] = [
    { type: "curve", surface },
    { type: "distribution", surface, bins: BINS },
    { type: "annotate", surface, annotation: "error-around" },
  ];
  return all.flatMap((question) => {
    const key = keyOf(state, question.type);
    const isDue = key !== undefined && about.includes(question.type) && state.questions.includes(question.type) && state.answers[question.type]?.key !== key;
    return isDue ? [{ key, question }] : [];
  });
}

/** Answers of a surface that is being replaced: shown until there are others, but asked for again. */
export function outdated({ curve, distribution }: Answers): Answers {
  return { ...(curve && { curve: { ...curve, key: "" } }), ...(distribution && { distribution: { ...distribution, key: "" } }) };
}

/** Codes of errors that are about a question: the surface is what it was. */
const QUESTION_CODES: readonly string[] = ["bad-question", "no-surface", "unknown-surface"];

export function isAboutQuestion(message: ServerMessage): boolean {
  return message.type === "error" && QUESTION_CODES.includes(message.code);
}
