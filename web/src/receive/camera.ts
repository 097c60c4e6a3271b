// The browser's camera as gray frames for the server: the square in the middle, reduced, no more on the way than it takes.

/** Frames on the way that the server has not taken yet, at most: it looks at some seconds of them at once. */
const ON_THE_WAY = 80;

/** Bytes before the pixels of a frame: time, number, columns, rows. */
const HEAD = 16;

export interface Counts {
  seen: number;
  sent: number;
  /** Frames that found no place, as the network or the server was too slow. */
  unsent: number;
}

/** Asks for a camera: a named one, else the one at the back; as many frames a second as it has at 720 rows. */
export function opened(device: string): Promise<MediaStream> {
  if (!("mediaDevices" in navigator)) {
    return Promise.reject(new Error(
      "The browser allows the camera only on the server's own machine or by HTTPS: upload a video instead.",
    ));
  }
  const which = device === "" ? { facingMode: "environment" } : { deviceId: { exact: device } };
  return navigator.mediaDevices.getUserMedia({
    video: { ...which, width: { ideal: 1280 }, height: { ideal: 720 }, frameRate: { ideal: 60 } }, audio: false,
  });
}

export class Camera {
  readonly counts: Counts = { seen: 0, sent: 0, unsent: 0 };
  private taken = 0;
  private running = true;
  private lastTime = -1;
  private readonly context: CanvasRenderingContext2D;

  constructor(private readonly video: HTMLVideoElement, private readonly size: number, private readonly to: WebSocket) {
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = size;
    this.context = canvas.getContext("2d", { willReadFrequently: true, alpha: false })!;
    this.next();
  }

  stop(): void {
    this.running = false;
  }

  /** The server has taken so many frames. */
  took(frames: number): void {
    this.taken = frames;
  }

  private next(): void {
    if (!this.running) return;
    if ("requestVideoFrameCallback" in this.video) {
      this.video.requestVideoFrameCallback((now, data) => {
        this.frame(data.captureTime ?? now);
        this.next();
      });
    } else {
      requestAnimationFrame((now) => {
        this.frame(now);
        this.next();
      });
    }
  }

  private frame(timeMs: number): void {
    if (!this.running || this.to.readyState !== WebSocket.OPEN || timeMs <= this.lastTime) return;
    this.counts.seen += 1;
    if (this.counts.sent - this.taken >= ON_THE_WAY) {
      this.counts.unsent += 1;
      return;
    }
    this.lastTime = timeMs;
    this.to.send(this.message(timeMs / 1000));
    this.counts.sent += 1;
  }

  private message(timeS: number): ArrayBuffer {
    const { videoWidth: width, videoHeight: height } = this.video;
    const square = Math.min(width, height);
    this.context.drawImage(this.video, (width - square) / 2, (height - square) / 2, square, square, 0, 0, this.size, this.size);
    const pixels = this.context.getImageData(0, 0, this.size, this.size).data;
    const message = new ArrayBuffer(HEAD + this.size * this.size);
    const head = new DataView(message);
    head.setFloat64(0, timeS, true);
    head.setUint32(8, this.counts.seen, true);
    head.setUint16(12, this.size, true);
    head.setUint16(14, this.size, true);
    const gray = new Uint8Array(message, HEAD);
    // luma of Rec. ITU-R BT.601
    for (let k = 0; k < gray.length; k += 1) {
      gray[k] = (77 * pixels[4 * k]! + 150 * pixels[4 * k + 1]! + 29 * pixels[4 * k + 2]!) >> 8;
    }
    return message;
  }
}
