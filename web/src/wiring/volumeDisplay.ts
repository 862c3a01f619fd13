/** What the look says of the volume, shown in the scene. What draws it is loaded when it is first shown. */

import type { VolumeInfo } from "../protocol/types";
import type { SurfaceRenderer } from "../scene/renderer";
import { usualWindow } from "../state/bounds";
import { windowOf, type Look } from "../state/look";
import type { Surface } from "../state/surfaceList";
import type { Theme } from "../ui/theme";
import { once } from "./later";
import type { VolumeShower, VolumeWanted } from "./volumeShower";

/** Colours of values on a dark and a light background: in general, and from the isovalue on. */
const INKS = { dark: { ink: "#dbe4ee", marked: "#ff9f45" }, light: { ink: "#243140", marked: "#c8500a" } } as const;

function inksOn({ background }: Pick<Look, "background">, page: Theme): (typeof INKS)[Theme] {
  if (background === "page") return INKS[page];
  return background === "white" ? INKS.light : INKS.dark;
}

/** What is to be shown of a volume with a surface; `undefined`: nothing. */
export function volumeWanted(look: Look, volume: VolumeInfo, step: number, surface: Pick<Surface, "view"> | undefined, page: Theme): VolumeWanted | undefined {
  const { mode, opacity, marksIso } = look.volume;
  if (mode === "off" || surface === undefined) return undefined;
  const { field, iso } = surface.view;
  const isOwn = volume.fields.some(({ name }) => name === field);
  const window = windowOf(look.volume, field) ?? (isOwn ? usualWindow(volume, field) : undefined);
  const style = { isMaximum: mode === "maximum", opacity, window, iso: marksIso ? iso : undefined, ...inksOn(look, page) };
  return { volume, step, field, style };
}

export class VolumeDisplay {
  private wanted: VolumeWanted | undefined;
  private theme: Theme = "dark";
  private last: readonly [Look, VolumeInfo, number, Surface | undefined] | undefined;
  private readonly shower: () => Promise<VolumeShower>;
  private isLoaded = false;

  /** @param onError what cannot be shown, for the user */
  constructor(
    scene: SurfaceRenderer,
    base: URL,
    private readonly onError: (reason: string) => void,
  ) {
    this.shower = once(async () => {
      const { VolumeShower } = await import("./volumeShower");
      return new VolumeShower((picture) => scene.setVolume(picture), onError, base);
    });
  }

  setTheme(theme: Theme): void {
    this.theme = theme;
    if (this.last !== undefined) this.show(...this.last);
  }

  show(look: Look, volume: VolumeInfo, step: number, surface: Surface | undefined): void {
    this.last = [look, volume, step, surface];
    this.wanted = volumeWanted(look, volume, step, surface, this.theme);
    if (this.wanted === undefined && !this.isLoaded) return;
    this.isLoaded = true;
    this.shower().then(
      (shower) => shower.show(this.wanted),
      (error: unknown) => this.onError(`The volume cannot be shown: ${String(error)}`),
    );
  }
}
