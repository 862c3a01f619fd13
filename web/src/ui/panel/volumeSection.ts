/** Which volume and time step is open. */

import type { VolumeInfo, VolumeSummary } from "../../protocol/types";
import { Select, Slider } from "../controls";
import { h, setText } from "../dom";
import { formatValue } from "../format";
import { section } from "./section";

export interface VolumeHandlers {
  readonly onVolume: (id: string) => void;
  readonly onStep: (step: number) => void;
}

export class VolumeSection {
  readonly element: HTMLElement;
  private readonly volumes: Select;
  private readonly facts = h("p", { class: "facts" });
  private readonly step: Slider;
  private steps = 1;

  constructor(handlers: VolumeHandlers) {
    this.volumes = new Select("Volume", "Volume to look at", handlers.onVolume);
    this.step = new Slider("Time step", "Time step of the volume", {
      scale: {
        toValue: (t) => Math.round(t * (this.steps - 1)),
        toPosition: (step) => (this.steps > 1 ? step / (this.steps - 1) : 0),
      },
      min: 0,
      max: Infinity,
      step: () => 1,
      onChange: (step) => handlers.onStep(Math.min(this.steps - 1, Math.round(step))),
    });
    this.element = section("", this.volumes.element, this.facts, this.step.element);
    this.step.element.hidden = true;
  }

  setVolumes(volumes: readonly VolumeSummary[], open: string | undefined): void {
    this.volumes.set(
      volumes.map((v) => ({ value: v.id, text: v.title })),
      open,
    );
  }

  setVolume(volume: VolumeInfo, step: number): void {
    const { dims, spacing } = volume.geometry;
    const product = (values: readonly number[]) => values.map((v) => formatValue(v, 4)).join(" × ");
    setText(this.facts, `${product(dims)} samples, ${product(spacing)} apart`);
    this.steps = volume.steps;
    this.step.element.hidden = volume.steps < 2;
    this.step.set(step);
  }
}
