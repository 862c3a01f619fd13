/** The page's pictures: lines on a grid of 24, in the colour of the text. */

const PATHS = {
  undo: "M9 14 4 9l5-5M4 9h10a6 6 0 0 1 0 12h-3",
  redo: "m15 14 5-5-5-5M20 9H10a6 6 0 0 0 0 12h3",
  fit: "M4 9V5a1 1 0 0 1 1-1h4M15 4h4a1 1 0 0 1 1 1v4M20 15v4a1 1 0 0 1-1 1h-4M9 20H5a1 1 0 0 1-1-1v-4M12 9.5v5M9.5 12h5",
  share: "M12 15V4M8 7.5 12 3.5l4 4M5 12v6a2 2 0 0 0 2 2h10a2 2 0 0 0 2-2v-6",
  upload: "M4 8V6a2 2 0 0 1 2-2h3l2 2.500h7a2 2 0 0 1 2 2V18a2 2 0 0 1-2 2H6a2 2 0 0 1-2-2V8ZM12 17v-6M9 13.500l3-3 3 3",
  help: "M12 21a9 9 0 1 0 0-18 9 9 0 0 0 0 18ZM9.5 9.5a2.5 2.5 0 1 1 3.6 2.2c-.8.4-1.1.9-1.1 1.8M12 16.7v.1",
  theme: "M12 21a9 9 0 1 0 0-18 9 9 0 0 0 0 18ZM12 3v18M12 7.5 18.5 6M12 12h9M12 16.5l6.5 1.5",
  panel: "M5 4h14a1 1 0 0 1 1 1v14a1 1 0 0 1-1 1H5a1 1 0 0 1-1-1V5a1 1 0 0 1 1-1ZM15 4v16",
  surface: "M3 18c2-6 4-9 6-9s3 5 5 5 4-8 7-8M3 21h18",
  detail: "M12 3 3.5 8v8.2L12 21l8.5-4.8V8L12 3ZM12 3v18M3.5 8 12 13l8.5-5M3.5 16.2 12 13l8.5 3.2",
  matters: "m12 3.5 2.6 5.4 5.9.8-4.3 4.1 1 5.9-5.2-2.8-5.2 2.8 1-5.9-4.3-4.1 5.9-.8L12 3.5Z",
  look: "M2.5 12S6 5.5 12 5.5 21.5 12 21.5 12 18 18.5 12 18.5 2.5 12 2.5 12ZM12 15a3 3 0 1 0 0-6 3 3 0 0 0 0 6Z",
  hidden: "M2.5 12S6 5.5 12 5.5 21.5 12 21.5 12 18 18.5 12 18.5 2.5 12 2.5 12ZM4 20 20 4",
  view: "M4 8h3.5l1.5-2.5h6L16.5 8H20v11H4V8ZM12 16.5a3 3 0 1 0 0-6 3 3 0 0 0 0 6Z",
  clip: "M4 5h10a2 2 0 0 1 2 2v12H6a2 2 0 0 1-2-2V5ZM10 2v3M10 8v3M10 14v3M10 20v2",
  slices: "m12 3 9 4.5-9 4.5-9-4.5L12 3ZM3 12l9 4.5 9-4.5M3 16.5 12 21l9-4.5",
  measure: "M3.500 15.500 15.500 3.500l5 5-12 12-5-5ZM7 12l2 2M10 9l3 3M13 6l2 2",
  image: "M4 5h16v14H4V5ZM4 16l5-5 4 4 3-3 4 4M15.5 9.5h.1",
  compare: "M12 3v18M4 6h5v12H4V6ZM15 6h5v12h-5",
  numbers: "M5 20V11M12 20V4M19 20v-6",
  time: "M12 21a9 9 0 1 0 0-18 9 9 0 0 0 0 18ZM12 7v5l3.5 2",
  play: "M7 4.500v15l12.500-7.500L7 4.500Z",
  pause: "M8 5v14M16 5v14",
  previous: "M18 5.500v13L8.500 12 18 5.500ZM6 5v14",
  next: "M6 5.500v13l9.500-6.500L6 5.500ZM18 5v14",
  loop: "M4 11a8 8 0 0 1 14-4.500l2 2M20 4v4.500h-4.500M20 13a8 8 0 0 1-14 4.500l-2-2M4 20v-4.500h4.500",
  chevron: "m8 10 4 4 4-4",
  close: "M6 6l12 12M18 6 6 18",
  link: "M10 14a4 4 0 0 0 5.7 0l3.2-3.2a4 4 0 0 0-5.7-5.7L12 6.3M14 10a4 4 0 0 0-5.7 0l-3.2 3.2a4 4 0 0 0 5.7 5.7L12 17.7",
} as const;

export type IconName = keyof typeof PATHS;

export function Icon(props: { readonly name: IconName }) {
  return (
    <svg class="icon" viewBox="0 0 24 24" aria-hidden="true">
      <path d={PATHS[props.name]} />
    </svg>
  );
}
