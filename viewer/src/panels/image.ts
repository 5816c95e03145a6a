// The newest picture of a camera, decoded without blob: or data: addresses. A drag picks a box, with Shift one more;
// with the keyboard Enter begins a box in the middle, arrow keys move it, + and - change its size, Enter picks it.

import { Frame, Sheet, ageText, bytesOf, colour, rateText } from "../dom.ts";
import type { Kind, Panel } from "../panel.ts";
import type { Picks } from "../picks.ts";

type Shown = { why?: string; topic?: string; topics?: string[]; at_s?: number; from_before?: boolean; rate_hz?: number | null; mime?: string; width?: number; height?: number; note?: string; bulk?: string; whole?: number[]; frame?: string };
type Rectangle = [left: number, top: number, right: number, bottom: number];

const STALE_S = 2;
const DRAG_PX = 4; // what moves by less is no box, but one around a point
const AROUND_PX = 5; // of the picture: half the side of that
const STEP = 1 / 20;
const BOX = "#0b6a58";

export class ImagePanel implements Panel {
  chosen = "";
  private readonly frame: Frame;
  private readonly sheet: Sheet;
  private picture: ImageBitmap | null = null;
  private shown: Shown = {};
  private next: Shown | null = null;
  private busy = false;
  private box: Rectangle | null = null; // as it is drawn, in shares of the picture
  private held: Shown | null = null; // the picture in which it is begun, which stands still meanwhile
  private nowS = 0;

  constructor(private readonly section: HTMLElement, private readonly picks: Picks) {
    this.frame = new Frame(section, "Image", true, (topic) => { this.chosen = topic; this.picture?.close(); this.picture = null; this.shown = {}; this.drop(); });
    this.sheet = new Sheet(this.frame.body, () => this.draw());
    const canvas = this.sheet.canvas;
    canvas.classList.add("shown");
    canvas.tabIndex = 0;
    let from: [number, number] | null = null;
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || !this.picture) return;
      from = [event.offsetX, event.offsetY];
      canvas.setPointerCapture(event.pointerId);
      this.held = this.shown;
    });
    canvas.addEventListener("pointermove", (event) => { if (from) { this.box = this.between(from, [event.offsetX, event.offsetY]); this.draw(); } });
    canvas.addEventListener("pointerup", (event) => {
      if (!from) return;
      const isPoint = Math.hypot(event.offsetX - from[0], event.offsetY - from[1]) < DRAG_PX;
      this.box = isPoint ? this.around(from) : this.between(from, [event.offsetX, event.offsetY]);
      from = null;
      this.pick(event.shiftKey);
    });
    canvas.addEventListener("pointercancel", () => { from = null; this.drop(); });
    canvas.addEventListener("blur", () => this.drop());
    canvas.addEventListener("keydown", (event) => this.press(event));
  }

  update(shown: Shown): void {
    this.frame.offer(shown.topics ?? [], this.chosen || shown.topic || "");
    this.frame.tell(shown.why && !this.picture ? shown.why : "");
    this.frame.tellFoot(shown.why && this.picture ? [shown.why] : []);
    if (!shown.bulk) return;
    this.next = shown; // of pictures that come faster than they are decoded only the newest counts
    if (!this.busy && !this.held) void this.decode();
  }

  private async decode(): Promise<void> {
    this.busy = true;
    while (this.next && !this.held) {
      const shown: Shown = this.next;
      this.next = null;
      try {
        const made = await createImageBitmap(new Blob([bytesOf(shown.bulk ?? "")], { type: shown.mime ?? "" }));
        if (this.held) { this.next ??= shown; made.close(); break; }
        this.picture?.close();
        this.picture = made;
        this.shown = shown;
        this.sheet.canvas.setAttribute("aria-label", `Picture of ${shown.topic}, ${shown.width} by ${shown.height} pixels. ${shown.note ?? ""}`);
        this.draw();
      } catch { this.frame.tell("This picture cannot be decoded."); }
    }
    this.busy = false;
  }

  // ── picking ─────────────────────────────────────────────────────────────────────────────────────────────────────

  private drop(): void {
    this.release();
    this.draw();
  }

  private release(): void {
    this.box = this.held = null;
    if (!this.busy) void this.decode();
  }

  /** Where the picture is drawn: its left and top, width and height. */
  private drawnAt(): [number, number, number, number] {
    const { width, height } = this.sheet, { width: wide = 1, height: high = 1 } = this.picture ?? {};
    const scale = Math.min(width / wide, height / high);
    return [(width - wide * scale) / 2, (height - high * scale) / 2, wide * scale, high * scale];
  }

  private between(one: [number, number], other: [number, number]): Rectangle | null {
    const [left, top, width, height] = this.drawnAt();
    const share = (at: number, from: number, size: number): number => Math.min(Math.max((at - from) / size, 0), 1);
    const [x1, x2] = [share(one[0], left, width), share(other[0], left, width)], [y1, y2] = [share(one[1], top, height), share(other[1], top, height)];
    return x1 === x2 || y1 === y2 ? null : [Math.min(x1, x2), Math.min(y1, y2), Math.max(x1, x2), Math.max(y1, y2)];
  }

  private around([x, y]: [number, number]): Rectangle | null {
    const [, , width] = this.drawnAt(), reach = (AROUND_PX / (this.shown.whole?.[0] ?? width)) * width;
    return this.between([x - reach, y - reach], [x + reach, y + reach]);
  }

  private pick(beside: boolean): void {
    const shown = this.held ?? this.shown, [wide = 0, high = 0] = shown.whole ?? [], box = this.box;
    this.release();
    if (box && wide && high && shown.topic && shown.at_s !== undefined) {
      const [left, top, right, bottom] = box;
      const last = (end: number, begin: number, size: number): number => Math.max(Math.ceil(end * size) - 1, begin);
      const [x, y] = [Math.min(Math.floor(left * wide), wide - 1), Math.min(Math.floor(top * high), high - 1)];
      this.picks.pick({ kind: "box", topic: shown.topic, frame: shown.frame ?? "", box: [x, y, last(right, x, wide), last(bottom, y, high)], size: [wide, high], at_s: shown.at_s, now_s: this.nowS }, beside, this.section);
    }
    this.draw();
  }

  private press(event: KeyboardEvent): void {
    if (event.ctrlKey || event.metaKey || event.altKey || !this.picture) return;
    if (event.key === "Enter" && !this.box) { this.held = this.shown; this.box = [0.4, 0.4, 0.6, 0.6]; }
    else if (event.key === "Enter") this.pick(event.shiftKey);
    else if (event.key === "Escape" && this.box) { event.stopPropagation(); this.drop(); }
    else if (!this.box || !this.moved(event.key, this.box)) return;
    event.preventDefault();
    this.draw();
  }

  /** Whether the key means something for a box that is being drawn. */
  private moved(key: string, [left, top, right, bottom]: Rectangle): boolean {
    const by: Record<string, Rectangle> = {
      ArrowLeft: [-STEP, 0, -STEP, 0], ArrowRight: [STEP, 0, STEP, 0], ArrowUp: [0, -STEP, 0, -STEP], ArrowDown: [0, STEP, 0, STEP],
      "+": [-STEP / 2, -STEP / 2, STEP / 2, STEP / 2], "=": [-STEP / 2, -STEP / 2, STEP / 2, STEP / 2], "-": [STEP / 2, STEP / 2, -STEP / 2, -STEP / 2],
    };
    const step = by[key];
    if (!step) return false;
    const next: Rectangle = [left + step[0], top + step[1], right + step[2], bottom + step[3]];
    if (next[0] > -1e-9 && next[1] > -1e-9 && next[2] < 1 + 1e-9 && next[3] < 1 + 1e-9 && next[2] - next[0] > STEP / 2) this.box = next.map((at) => Math.min(Math.max(at, 0), 1)) as Rectangle;
    return true;
  }

  tick(nowS: number, lost: boolean): void {
    this.nowS = nowS;
    if (!this.picture || this.shown.at_s === undefined) return this.frame.tellAge("", false);
    const age = nowS - this.shown.at_s, isOld = lost || age > STALE_S;
    this.frame.tellAge(`${rateText(this.shown.rate_hz, isOld)}${ageText(age, this.shown.from_before)}`, isOld);
  }

  mark(): void {
    this.draw();
  }

  private draw(): void {
    this.sheet.clear();
    this.picks.tellWhere(this.section, (one) => one.kind !== "box" || one.topic === this.shown.topic);
    const { pen, width } = this.sheet, picture = this.picture;
    if (!picture || !width) return;
    const [left, top, wide, high] = this.drawnAt();
    pen.imageSmoothingEnabled = wide / picture.width < 3;
    pen.drawImage(picture, left, top, wide, high);
    pen.strokeStyle = colour("line-deep"); // a bright wall at its edge does not run into the panel
    pen.lineWidth = 1;
    pen.strokeRect(left + 0.5, top + 0.5, wide - 1, high - 1);
    for (const { one, label } of this.picks.of("box")) {
      const [across = 1, down = 1] = one.size, [x1 = 0, y1 = 0, x2 = 0, y2 = 0] = one.box;
      if (one.topic === this.shown.topic) this.drawBox([x1 / across, y1 / down, (x2 + 1) / across, (y2 + 1) / down], label);
    }
    if (this.box) this.drawBox(this.box, "");
  }

  private drawBox(box: Rectangle, label: string): void {
    const { pen } = this.sheet, [left, top, wide, high] = this.drawnAt();
    const at = [left + box[0] * wide, top + box[1] * high, (box[2] - box[0]) * wide, (box[3] - box[1]) * high] as const;
    for (const [stroke, width] of [["#fff", 5], [BOX, 2.5]] as const) { // a picture is the same in both themes, and so is this
      pen.strokeStyle = stroke;
      pen.lineWidth = width;
      pen.strokeRect(...at);
    }
    if (!label) return;
    pen.font = "600 12px system-ui, sans-serif";
    pen.strokeStyle = "#fff";
    pen.lineWidth = 4;
    pen.fillStyle = BOX;
    pen.strokeText(label, at[0] + at[2] + 5, at[1] + 10);
    pen.fillText(label, at[0] + at[2] + 5, at[1] + 10);
  }
}

export const kind: Kind = { title: "Image", place: "image", order: 3, folds: true, make: (section, { picks }) => new ImagePanel(section, picks) };
