/** The side panel: volume, surface, decimation, importance, statistics. */

import type { Edit, Statistics, View, VolumeInfo, VolumeSummary } from "../../protocol/types";
import type { Points } from "../../transfer/model";
import { h } from "../dom";
import { DecimationSection } from "./decimationSection";
import { derivedFeature, ownRange } from "./features";
import { ImportanceSection } from "./importanceSection";
import { StatisticsSection } from "./statisticsSection";
import { SurfaceSection } from "./surfaceSection";
import type { TransferEditor } from "./transferEditor";
import { VolumeSection } from "./volumeSection";

export interface PanelHandlers {
  readonly onVolume: (id: string) => void;
  readonly onStep: (step: number) => void;
  readonly onEdit: (edit: Edit) => void;
  readonly onPoints: (points: Points) => void;
}

export class Panel {
  readonly element: HTMLElement;
  private readonly volumes: VolumeSection;
  private readonly surface: SurfaceSection;
  private readonly decimation: DecimationSection;
  private readonly importance: ImportanceSection;
  private readonly statistics = new StatisticsSection();
  /** All that edits the view. */
  private readonly edits: HTMLFieldSetElement;
  private volume: VolumeInfo | undefined;
  private view: View | undefined;

  constructor(private readonly handlers: PanelHandlers) {
    this.volumes = new VolumeSection(handlers);
    this.surface = new SurfaceSection({
      onField: (name) => this.chooseField(name),
      onIsovalue: (iso) => handlers.onEdit({ iso }),
    });
    this.decimation = new DecimationSection(handlers.onEdit);
    this.importance = new ImportanceSection(handlers);
    this.edits = h(
      "fieldset",
      { class: "edits", disabled: true },
      this.surface.element,
      this.decimation.element,
      this.importance.element,
    );
    this.element = h(
      "aside",
      { class: "panel", "aria-label": "Controls" },
      this.volumes.element,
      this.edits,
      this.statistics.element,
    );
    this.setStatistics(undefined);
  }

  get editor(): TransferEditor {
    return this.importance.editor;
  }

  setVolumes(volumes: readonly VolumeSummary[], open: string | undefined): void {
    this.volumes.setVolumes(volumes, open);
  }

  /** A volume is open at a step; `setView` follows. */
  setVolume(volume: VolumeInfo, step: number): void {
    this.volume = volume;
    this.volumes.setVolume(volume, step);
    this.edits.disabled = false;
  }

  /** Values in force. */
  setView(view: View): void {
    const { volume } = this;
    if (volume === undefined) return;
    this.view = view;
    this.surface.set(volume, view);
    this.importance.set(volume, view);
    this.decimation.setView(view, Math.min(...volume.geometry.spacing));
    this.showThreshold();
  }

  setStatistics(statistics: Statistics | undefined): void {
    this.decimation.setStatistics(statistics);
    this.statistics.set(statistics);
    this.showThreshold();
  }

  private showThreshold(): void {
    if (this.view !== undefined) this.editor.setThreshold(this.decimation.beta);
  }

  private chooseField(name: string): void {
    const { volume, view } = this;
    const field = volume?.fields.find((f) => f.name === name);
    if (volume === undefined || view === undefined || field === undefined) return;
    // What is derived from another field is another feature, with another range.
    const derived = derivedFeature(volume, { feature: view.feature, field: name });
    const iso = field.openingIso?.iso ?? view.iso;
    this.handlers.onEdit({ field: name, iso, ...(derived === undefined ? {} : { featureRange: ownRange(derived) }) });
  }
}
