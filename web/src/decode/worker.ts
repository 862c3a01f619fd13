/** The decoding worker. `queue.ts` decides which chunks are decoded. */

import { MeshoptDecoder } from "meshoptimizer/decoder";
import { DecodeService, type DecodeReply, type DecodeRequest } from "./service";

/** What the worker uses of its global scope; the DOM's types describe windows only. */
interface WorkerScope {
  postMessage(reply: DecodeReply, transfer: Transferable[]): void;
  onmessage: ((event: MessageEvent<DecodeRequest>) => void) | null;
}

const scope = self as unknown as WorkerScope;
const service = new DecodeService(MeshoptDecoder, (reply, transfer) => scope.postMessage(reply, transfer));

scope.onmessage = ({ data }) => service.receive(data);
