// Elements and small texts. Text of the robot only ever becomes text: nothing here, or anywhere, parses markup.

type Child = Node | string | null | undefined | false;

export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K, properties: { class?: string; [name: string]: string | undefined } = {}, ...children: Child[]
): HTMLElementTagNameMap[K] {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) if (value !== undefined) made.setAttribute(name, value);
  made.append(...children.filter((child): child is Node | string => !!child));
  return made;
}

export function byId<T extends HTMLElement = HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (!found) throw new Error(id);
  return found as T;
}

/** Sets a text only where it differs: a screen reader says what changes. */
export function say(at: HTMLElement, text: string): void {
  if (at.textContent !== text) at.textContent = text;
}

/** How ages are told: of a recording they count from the time that is shown. */
export const ages = { fresh: "now", old: "ago" };

/** `fromBefore`: it was sent before the server subscribed, and is told as the tools tell it (`from_before.py`). */
export function ageText(seconds: number, fromBefore = false): string {
  if (!Number.isFinite(seconds)) return "";
  if (fromBefore) return `${spanText(Math.max(seconds, 0))} old, from before`;
  if (seconds < 0.95) return ages.fresh;
  return `${spanText(seconds)} ${ages.old}`;
}

/** A line with what a panel shows that was sent before the server subscribed, each with its age. */
export const oldIn = (old: string[] = []): string => (old.length ? `${old.join("; ")}.` : "");

function spanText(seconds: number): string {
  if (seconds < 9.95) return `${seconds.toFixed(1)} s`;
  if (seconds < 120) return `${Math.round(seconds)} s`;
  if (seconds < 7200) return `${Math.round(seconds / 60)} min`;
  return seconds < 172800 ? `${Math.round(seconds / 3600)} h` : `${Math.round(seconds / 86400)} days`;
}

export function clock(time: string | number): string {
  const at = new Date(typeof time === "number" ? time * 1000 : time);
  return Number.isNaN(at.getTime()) ? "" : at.toTimeString().slice(0, 8);
}

export function bytesOf(base64: string): Uint8Array<ArrayBuffer> {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let at = 0; at < text.length; at++) bytes[at] = text.charCodeAt(at);
  return bytes;
}

export function colour(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

/** A canvas as large as its element, in the pixels of the screen. */
export class Sheet {
  readonly canvas = make("canvas", { role: "img" });
  readonly pen: CanvasRenderingContext2D;
  width = 0;
  height = 0;
  ratio = 1;
  constructor(at: HTMLElement, drawn: () => void) {
    const pen = this.canvas.getContext("2d");
    if (!pen) throw new Error("no canvas");
    this.pen = pen;
    at.append(this.canvas);
    new ResizeObserver(() => {
      this.ratio = window.devicePixelRatio || 1;
      this.width = at.clientWidth;
      this.height = at.clientHeight;
      this.canvas.width = Math.max(1, Math.round(this.width * this.ratio));
      this.canvas.height = Math.max(1, Math.round(this.height * this.ratio));
      drawn();
    }).observe(at);
  }
  clear(): void {
    this.pen.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    this.pen.clearRect(0, 0, this.width, this.height);
  }
}

/** The frame that all panels share: a title, a choice, an age, a body, and why there is nothing. */
export class Frame {
  readonly choice = make("select", { "aria-label": "Topic" });
  readonly body: HTMLElement;
  readonly foot = make("div", { class: "foot" });
  private readonly age = make("span", { class: "age" });
  private readonly why = make("div", { class: "why" }, make("span"));
  private options = "";
  constructor(readonly section: HTMLElement, title: string, full: boolean, chosen?: (topic: string) => void) {
    this.body = make("div", { class: full ? "body full" : "body", ...(full ? {} : { tabindex: "0" }) });
    section.append(
      make("div", { class: "head" }, make("h2", {}, title), chosen ? this.choice : null, this.age), this.body, this.foot);
    this.body.append(this.why);
    this.foot.hidden = this.choice.hidden = true;
    this.tell("Waiting for the first answer.");
    this.choice.addEventListener("change", () => chosen?.(this.choice.value));
  }
  offer(topics: string[], current: string): void {
    const all = topics.includes(current) || !topics.length && !current ? topics : [current, ...topics];
    const text = all.join("\n");
    if (text !== this.options) {
      this.options = text;
      this.choice.replaceChildren(...all.map((topic) => make("option", { value: topic }, topic || "choose …")));
    }
    this.choice.hidden = all.length === 0;
    if (document.activeElement !== this.choice) this.choice.value = current;
  }
  tell(why: string): void {
    this.why.hidden = !why;
    say(this.why.firstElementChild as HTMLElement, why);
  }
  tellAge(text: string, stale: boolean, bad = false): void {
    say(this.age, text);
    this.age.classList.toggle("bad", bad);
    this.section.classList.toggle("stale", stale);
  }
  tellFoot(parts: (Node | string)[]): void {
    this.foot.hidden = parts.length === 0;
    this.foot.replaceChildren(...parts);
  }
}

/** How often something comes, always with as many digits; nothing while that is not known, or no longer true. */
export const rateText = (hz: number | null | undefined, isOld = false): string => (hz && !isOld ? `${hz.toFixed(hz < 99.95 ? 1 : 0)} Hz · ` : "");

/** Sentences below a panel: one stands there whole, several open below a line that says how many. Anew only where they are other ones. */
export class Notes {
  private told = "";
  private isOpen = false;
  constructor(private readonly frame: Frame, private readonly what: string) { }
  /** `first` is always seen. */
  tell(lines: string[], first = ""): void {
    const told = [first, ...lines].join("\n");
    if (told === this.told) return;
    this.told = told;
    const rows = lines.map((line) => make("div", {}, line)), above = first ? [make("div", {}, first)] : [];
    if (rows.length < 2) return this.frame.tellFoot([...above, ...rows]);
    const hadFocus = this.frame.foot.contains(document.activeElement), head = make("summary", {}, `${lines.length} ${this.what}`), all = make("details", {}, head, ...rows);
    all.open = this.isOpen;
    all.addEventListener("toggle", () => { this.isOpen = all.open; });
    this.frame.tellFoot([...above, all]);
    if (hadFocus) head.focus();
  }
}
