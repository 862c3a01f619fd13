/** What the page does as the connection comes and goes: says so, and lists the volumes. */

import type { ConnectionState } from "../net/connection";
import { listVolumes } from "../net/rest";
import type { VolumeSummary } from "../protocol/types";
import type { Model } from "../ui/model";

export class Connecting {
  /** @param onVolumes the server's volumes, each time that the connection is made */
  constructor(
    private readonly model: Model,
    private readonly base: URL,
    private readonly onVolumes: (volumes: readonly VolumeSummary[]) => void,
  ) {}

  /** @param reason why the last connection was closed, where that is known */
  changed(state: ConnectionState, reason: string | undefined): void {
    const { model } = this;
    const isConnected = state === "connected";
    model.showConnection({ isConnected, reason: state === "waiting" ? reason : model.connection().reason });
    if (!isConnected) return;
    model.showConnection({ isConnected, reason: undefined });
    void this.loadVolumes();
  }

  private async loadVolumes(): Promise<void> {
    let volumes: readonly VolumeSummary[];
    try {
      volumes = await listVolumes(this.base);
    } catch (error) {
      this.model.toast(`The list of volumes could not be read: ${error instanceof Error ? error.message : String(error)}`);
      return;
    }
    this.onVolumes(volumes);
  }
}
