/** Pages of the documentation that come with the viewer: a build puts them beside it, as text (`vite.config.ts`). */

interface Document {
  readonly name: string;
  readonly about: string;
}

export const DOCUMENTS: readonly Document[] = [
  { name: "algorithm", about: "how it decides what to merge" },
  { name: "glossary", about: "the words" },
  { name: "command-line", about: "the same without a browser" },
  { name: "embedding", about: "the viewer in another page" },
  { name: "fidelity", about: "the accuracy of its surfaces" },
];
