// The newest picture of a camera, decoded without blob: or data: addresses.

import { Frame, Sheet, ageText, bytesOf } from "./dom.ts";

type Shown = { why?: string; topic?: string; topics?: string[]; at_s?: number; rate_hz?: number | null; mime?: string; width?: number; height?: number; note?: string; bulk?: string };

const STALE_S = 2;

export class ImagePanel {
  chosen = "";
  private readonly frame: Frame;
  private readonly sheet: Sheet;
  private picture: ImageBitmap | null = null;
  private shown: Shown = {};
  private next: Shown | null = null;
  private busy = false;

  constructor(section: HTMLElement) {
    this.frame = new Frame(section, "Image", true, (topic) => { this.chosen = topic; this.picture?.close(); this.picture = null; this.shown = {}; this.draw(); });
    this.sheet = new Sheet(this.frame.body, () => this.draw());
    this.sheet.canvas.classList.add("shown");
  }

  update(shown: Shown): void {
    this.frame.offer(shown.topics ?? [], this.chosen || shown.topic || "");
    this.frame.tell(shown.why && !this.picture ? shown.why : "");
    this.frame.tellFoot(shown.why && this.picture ? [shown.why] : []);
    if (!shown.bulk) return;
    this.next = shown; // of pictures that come faster than they are decoded only the newest counts
    if (!this.busy) void this.decode();
  }

  private async decode(): Promise<void> {
    this.busy = true;
    while (this.next) {
      const shown: Shown = this.next;
      this.next = null;
      try {
        const made = await createImageBitmap(new Blob([bytesOf(shown.bulk ?? "")], { type: shown.mime ?? "" }));
        this.picture?.close();
        this.picture = made;
        this.shown = shown;
        this.sheet.canvas.setAttribute("aria-label", `Picture of ${shown.topic}, ${shown.width} by ${shown.height} pixels. ${shown.note ?? ""}`);
        this.draw();
      } catch { this.frame.tell("This picture cannot be decoded."); }
    }
    this.busy = false;
  }

  tick(nowS: number, lost: boolean): void {
    if (!this.picture || this.shown.at_s === undefined) return this.frame.tellAge("", false);
    const age = nowS - this.shown.at_s;
    const rate = this.shown.rate_hz ? `${this.shown.rate_hz.toFixed(this.shown.rate_hz < 10 ? 1 : 0)} Hz · ` : "";
    this.frame.tellAge(`${rate}${ageText(age)}`, lost || age > STALE_S);
  }

  draw(): void {
    this.sheet.clear();
    const { pen, width, height } = this.sheet, picture = this.picture;
    if (!picture || !width) return;
    const scale = Math.min(width / picture.width, height / picture.height);
    pen.imageSmoothingEnabled = scale < 3;
    pen.drawImage(picture, (width - picture.width * scale) / 2, (height - picture.height * scale) / 2, picture.width * scale, picture.height * scale);
  }
}
