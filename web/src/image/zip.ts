/** Files in a zip that are stored as they are, as those that are compressed already. Loaded when one is asked for. */

import { Zip, ZipPassThrough } from "fflate";

/** Places and lengths in a zip have 32 bits. */
const MAX_BYTES = 2 ** 32 - 2 ** 20;

export class StoredZip {
  private bytes = 0;
  private readonly pieces: Uint8Array<ArrayBuffer>[] = [];
  private fault: Error | undefined;
  private readonly zip = new Zip((error, piece) => {
    if (error !== null) this.fault = error;
    else this.pieces.push(piece.slice());
  });

  /** @throws if it cannot be added */
  add(name: string, content: Uint8Array): void {
    this.bytes += content.length;
    if (this.bytes > MAX_BYTES) throw new Error(`the files have more than ${Math.floor(MAX_BYTES / 2 ** 20)} MB, which a zip cannot hold`);
    const file = new ZipPassThrough(name);
    this.zip.add(file);
    file.push(content, true);
    if (this.fault !== undefined) throw this.fault;
  }

  end(): Blob {
    this.zip.end();
    if (this.fault !== undefined) throw this.fault;
    return new Blob(this.pieces, { type: "application/zip" });
  }
}

/** The name of image `i`, padded with zeros to `digits` digits. */
export const imageName = (i: number, digits: number): string => `${String(i).padStart(digits, "0")}.png`;
