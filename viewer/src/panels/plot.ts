// Numbers over time. What has not come is not drawn: a gap is a gap, and where nothing comes the line ends.

import uPlot from "uplot";
import { Frame, Notes, ageText, bytesOf, colour, make, rateText, say } from "../dom.ts";
import type { Kind, Panel, Topics } from "../panel.ts";
import type { Picks } from "../picks.ts";

type Field = { name: string; unit: string };
type Told = { why?: string; topic?: string; fields?: Field[]; since_s?: number; first?: number; at_s?: number | null; from_before?: boolean; whole?: boolean; rate_hz?: number | null; notes?: string[]; bulk?: string };
type Column = (number | null | undefined)[];

const SPANS_S = [10, 30, 60];
const KEPT_S = 60;
const LEAST_GAP_S = 0.5;
const GAP_PERIODS = 4;
const MOST_DRAWN = 6;
const CLICK_PX = 4; // what moves by less is no drag
const LIGHT = ["#0072b2", "#c24e00", "#00795c", "#a3327f", "#7a6400", "#4a4fc4"];
const DARK = ["#56b4e9", "#f5a623", "#37d6a5", "#ee8fc6", "#e8dc5a", "#a9adff"];
const TELLING = [/linear\.x$/, /angular\.z$/, /^position\[/, /percentage$/, /voltage$/, /position\.[xy]$/, /^data/, /range$/, /temperature$/];
const DULL = /Image$|PointCloud2$|OccupancyGrid|TFMessage$|msg\/String$|LaserScan$|MarkerArray$|msg\/Path$|CameraInfo$|rcl_interfaces/;

export class PlotPanel implements Panel {
  chosen = "";
  private readonly frame: Frame;
  private readonly fields = make("div", { class: "curves", role: "group", "aria-label": "Curves" });
  private readonly sheet = make("div", { class: "sheet", role: "img", tabindex: "0" });
  private readonly notes: Notes;
  private readonly chips = new Map<string, HTMLElement>();
  private topics: string[] = [];
  private drawn: string[] = [];
  private told: Told = {};
  private times: number[] = [];
  private columns: Column[] = [];
  private next = 0; // the number of the row that has not been taken yet
  private spanS = 30;
  private flat = ""; // the drawn curves that lie on each other, as none of them moves
  private bare = new Set<string>(); // the curves whose scale has no axis here
  private still: [number, number] | null = null; // the time that a person has chosen to look at
  private plot: uPlot | null = null;
  private nowS = 0;
  private drawnAt = 0;
  private isNew = false; // what has come is not drawn yet

  constructor(private readonly section: HTMLElement, private readonly picks: Picks) {
    this.frame = new Frame(section, "Plot", true, (topic) => { this.chosen = topic; this.forget(); });
    this.notes = new Notes(this.frame, "notes");
    this.frame.body.append(make("div", { class: "plot" }, this.fields, this.sheet));
    new ResizeObserver(() => {
      const { clientWidth: width, clientHeight: height } = this.sheet;
      if (width > 40 && height > 40) { if (this.plot && axesIn(width) === axesIn(this.plot.width)) this.plot.setSize({ width, height }); else this.build(); }
    }).observe(this.sheet);
    this.sheet.addEventListener("keydown", (event) => this.press(event));
    let began = 0;
    this.sheet.addEventListener("pointerdown", (event) => { began = event.clientX; });
    this.sheet.addEventListener("pointerup", (event) => {
      if (event.button !== 0 || !this.plot || Math.abs(event.clientX - began) >= CLICK_PX) return;
      this.pick(this.plot.posToVal(event.clientX - this.plot.over.getBoundingClientRect().left, "x"), event.shiftKey);
    });
    this.sheet.addEventListener("dblclick", () => this.look(null));
  }

  offer(topics: Topics): void {
    this.topics = topics.filter(([, type]) => !DULL.test(type ?? "")).map(([name]) => name);
    this.frame.offer(this.topics, this.chosen || this.told.topic || "");
  }

  private forget(): void {
    [this.told, this.times, this.columns, this.next, this.drawn, this.still] = [{}, [], [], 0, [], null];
    this.fields.replaceChildren();
    this.chips.clear();
    this.build();
  }

  update(told: Told): void {
    this.frame.tell(told.why && !this.times.length ? told.why : "");
    this.notes.tell([...(told.why && this.times.length ? [told.why] : []), ...(told.notes ?? [])]);
    if (!told.bulk || !told.fields) return;
    const names = told.fields.map((field) => field.name).join("\n");
    const isOther = told.topic !== this.told.topic || names !== (this.told.fields ?? []).map((field) => field.name).join("\n");
    const before = this.drawn;
    if (isOther) { const kept = told.topic === this.told.topic ? before : []; this.forget(); this.drawn = kept; }
    if (told.whole || told.since_s !== this.told.since_s) this.next = 0;
    this.told = told;
    if (isOther) { this.list(told.fields); this.frame.offer(this.topics, this.chosen || told.topic || ""); }
    if (told.whole) { this.times = []; this.columns = []; }
    this.take(new Float64Array(bytesOf(told.bulk).buffer), told.fields.length, told.first ?? 0);
  }

  /** Appends the rows that are new. Where some were missed, or none came for long, the line has a gap. */
  private take(rows: Float64Array, fields: number, first: number): void {
    const width = fields + 1, count = Math.floor(rows.length / width);
    if (this.columns.length !== fields) { this.times = []; this.columns = Array.from({ length: fields }, () => []); }
    if (first > this.next && this.next > 0) this.cut((rows[0] ?? 0) - 1e-3);
    for (let row = Math.max(this.next - first, 0); row < count; row++) {
      const at = rows[row * width] ?? 0, last = this.times.at(-1);
      if (last !== undefined && at <= last) continue;
      if (last !== undefined && at - last > this.gapS()) this.cut((at + last) / 2);
      this.times.push(at);
      this.columns.forEach((column, index) => {
        const value = rows[row * width + index + 1] ?? NaN;
        column.push(Number.isNaN(value) ? undefined : Number.isFinite(value) ? value : null);
      });
    }
    this.next = Math.max(this.next, first + count);
    const old = this.times.findIndex((at) => at > (this.times.at(-1) ?? 0) - KEPT_S);
    if (old > 200) { this.times.splice(0, old); for (const column of this.columns) column.splice(0, old); }
    this.draw(true);
  }

  private cut(at: number): void {
    if (at <= (this.times.at(-1) ?? Infinity)) return;
    this.times.push(at);
    for (const column of this.columns) column.push(null);
  }

  private gapS(): number {
    const rate = this.told.rate_hz;
    const newest = this.times.slice(-40), steps = newest.slice(1).map((at, index) => at - (newest[index] ?? at)).sort((a, b) => a - b);
    const usual = rate ? 1 / rate : steps[Math.floor(steps.length / 2)] ?? Infinity;
    return Math.max(LEAST_GAP_S, GAP_PERIODS * usual);
  }

  // ── which curves ────────────────────────────────────────────────────────────────────────────────────────────────

  private list(fields: Field[]): void {
    const names = fields.map((field) => field.name), labels = names.map((name) => briefName(name, names));
    this.drawn = this.drawn.filter((name) => names.includes(name));
    for (const pattern of TELLING) if (this.drawn.length < 2) this.drawn.push(...names.filter((name) => pattern.test(name)).slice(0, 4));
    if (!this.drawn.length) this.drawn = names.slice(0, 3);
    this.drawn = [...new Set(this.drawn)].slice(0, MOST_DRAWN);
    this.fields.replaceChildren(...fields.map((field, index) => {
      const value = make("span", { class: "value" });
      const chip = make("button", { type: "button", "aria-pressed": "false" }, make("i", { "aria-hidden": "true" }), make("span", { class: "name" }, labels[index] ?? ""), value);
      chip.title = field.name;
      chip.addEventListener("click", () => {
        if (this.drawn.includes(field.name)) this.drawn = this.drawn.filter((one) => one !== field.name);
        else this.drawn = [...this.drawn.slice(-(MOST_DRAWN - 1)), field.name];
        this.build();
      });
      this.chips.set(field.name, chip);
      return chip;
    }));
    this.build();
  }

  private tint(name: string): string {
    const tints = document.documentElement.dataset.theme === "dark" ? DARK : LIGHT;
    return tints[this.drawn.indexOf(name) % tints.length] ?? "";
  }

  // ── drawing ─────────────────────────────────────────────────────────────────────────────────────────────────────

  repaint(): void {
    this.build();
  }

  private build(): void {
    this.plot?.destroy();
    this.plot = null;
    for (const [name, chip] of this.chips) {
      const isDrawn = this.drawn.includes(name);
      chip.setAttribute("aria-pressed", String(isDrawn));
      (chip.firstElementChild as HTMLElement).style.background = isDrawn ? this.tint(name) : "";
    }
    const { clientWidth: width, clientHeight: height } = this.sheet, fields = this.told.fields ?? [];
    if (width <= 40 || height <= 40 || !this.drawn.length) return;
    const curves = this.drawn.map((name) => ({ name, unit: fields.find((field) => field.name === name)?.unit ?? "" }));
    const units = [...new Set(curves.map((curve) => curve.unit))]; // each has a scale of its own, and an axis where there is room
    const axes = units.slice(0, axesIn(width));
    this.bare = new Set(curves.filter(({ unit }) => !axes.includes(unit)).map(({ name }) => name));
    const scaleOf = (unit: string): string => `u${units.indexOf(unit)}`;
    const ink = { stroke: colour("soft"), font: "11px system-ui, sans-serif", ticks: { show: false }, grid: { stroke: colour("line"), width: 1 } };
    const inkOf = (unit: string): string => { // that of its curve, if it has one
      const [first, ...others] = curves.filter((curve) => curve.unit === unit);
      return units.length > 1 && first && !others.length ? this.tint(first.name) : ink.stroke;
    };
    const yAxis = (unit: string, index: number): uPlot.Axis => ({
      ...ink, stroke: inkOf(unit), space: 46, scale: `u${index}`, side: index ? 1 : 3, size: 44 + Math.min(unit.length, 8) * 5, // the unit stands at the topmost number
      grid: index ? { show: false } : ink.grid, values: (_, ticks) => ticks.map((tick, at) => (at === ticks.length - 1 && unit ? `${short(tick)} ${unit}` : short(tick))),
    });
    const range: uPlot.Range.Function = (_, low, high) => {
      if (low === null || high === null) return [0, 1];
      const room = Math.max((high - low) * 0.12, Math.abs(high) * 1e-6, 1e-6);
      return high - low < 1e-9 ? [low - Math.max(Math.abs(low) * 0.25, 0.13), high + Math.max(Math.abs(high) * 0.25, 0.13)] : [low - room, high + room];
    };
    this.plot = new uPlot({
      width, height, legend: { show: false }, padding: [10, units.length > 1 ? 4 : 14, 0, 0], pxAlign: 0,
      cursor: { drag: { x: true, y: false, setScale: false }, points: { size: 6 }, y: false },
      scales: { x: { time: false, range: () => this.range() }, ...Object.fromEntries(units.map((_, index) => [`u${index}`, { range }])) },
      axes: [{ ...ink, size: 26, space: 76, splits: (plot, _, low, high, step) => this.marks(plot, low, high, step), values: (_, ticks) => ticks.map((at) => this.timeText(at)) }, ...axes.map(yAxis)],
      series: [{}, ...curves.map((curve) => ({ label: curve.name, scale: scaleOf(curve.unit), stroke: this.tint(curve.name), ...this.stroke(curve.name), points: { show: false } }))],
      hooks: {
        setSelect: [(plot) => {
          if (plot.select.width > 4) this.look([plot.posToVal(plot.select.left, "x"), plot.posToVal(plot.select.left + plot.select.width, "x")]);
          plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
        }],
        setCursor: [() => this.tellValues()],
        drawAxes: [(plot) => this.drawGaps(plot)],
        draw: [(plot) => this.drawTimes(plot)],
      },
    }, this.data(), this.sheet);
    this.tellValues();
  }

  // ── picking ─────────────────────────────────────────────────────────────────────────────────────────────────────

  /** Picks the row nearest to a time, with the values of the curves that are drawn. */
  private pick(at: number, beside: boolean): void {
    const off = (row: number): number => Math.abs((this.times[row] ?? Infinity) - at), told = this.told.fields ?? [];
    const values = (row: number) => told.flatMap(({ name, unit }, index) => {
      const value = this.columns[index]?.[row];
      return this.drawn.includes(name) && typeof value === "number" ? [{ name, value, unit }] : [];
    });
    const row = [...this.times.keys()].sort((one, other) => off(one) - off(other)).find((one) => values(one).length);
    if (row === undefined || !this.told.topic) return;
    this.picks.pick({ kind: "time", topic: this.told.topic, at_s: this.times[row] ?? 0, now_s: this.nowS, values: values(row) }, beside, this.section);
  }

  /** Draws anew what is picked. */
  mark(): void { this.plot?.redraw(false); }

  private drawTimes(plot: uPlot): void {
    const { ctx, bbox } = plot;
    for (const { one, label } of this.picks.of("time")) {
      const x = Math.round(plot.valToPos(one.at_s, "x", true));
      if (one.topic !== this.told.topic || x < bbox.left || x > bbox.left + bbox.width) continue;
      const ratio = devicePixelRatio, y = bbox.top + 13 * ratio;
      ctx.save();
      ctx.strokeStyle = ctx.fillStyle = colour("ink"); // no curve's colour, and dashed: it is no value
      ctx.lineWidth = ratio;
      ctx.setLineDash([3 * ratio, 4 * ratio]);
      ctx.beginPath();
      ctx.moveTo(x, y + 6 * ratio);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
      ctx.setLineDash([]);
      ctx.lineWidth = 1.75 * ratio;
      ctx.beginPath(); // ring and cross, as on the map
      ctx.arc(x, y, 6 * ratio, 0, 7);
      for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]] as const) { ctx.moveTo(x + dx * 3 * ratio, y + dy * 3 * ratio); ctx.lineTo(x + dx * 9 * ratio, y + dy * 9 * ratio); }
      ctx.stroke();
      ctx.textAlign = "left";
      ctx.font = `600 ${12 * devicePixelRatio}px system-ui, sans-serif`;
      ctx.fillText(label, x + 11 * ratio, bbox.top + 12 * ratio);
      ctx.restore();
    }
  }

  /** Spans in which nothing came are shaded, and say so where there is room: a line that is missing is no zero. */
  private drawGaps(plot: uPlot): void {
    const { ctx, bbox } = plot, [begin, end] = this.range(), least = this.gapS(), gaps: [number, number][] = [];
    let before = begin;
    this.times.forEach((at, row) => {
      if (!this.columns.some((column) => typeof column[row] === "number")) return;
      if (at >= begin && at - before > least) gaps.push([Math.max(before, begin), Math.min(at, end)]);
      before = at;
    });
    if (end - before > least) gaps.push([Math.max(before, begin), end]);
    ctx.save();
    ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
    ctx.textAlign = "center";
    for (const [from, to] of gaps) {
      const left = Math.max(plot.valToPos(from, "x", true), bbox.left), right = Math.min(plot.valToPos(to, "x", true), bbox.left + bbox.width);
      if (right <= left) continue;
      ctx.fillStyle = colour("no-data");
      ctx.fillRect(left, bbox.top, right - left, bbox.height);
      ctx.fillStyle = colour("soft");
      if (right - left > 54 * devicePixelRatio) ctx.fillText("no data", (left + right) / 2, bbox.top + bbox.height - 8 * devicePixelRatio);
    }
    ctx.restore();
  }

  /** Curves that stand still lie on each other, each in the middle of its scale: the lower ones are broader, the upper ones dashed. */
  private stroke(name: string): { width: number; dash?: number[] } {
    const at = this.flat.split("\n").indexOf(name), all = this.flat ? this.flat.split("\n").length : 0;
    if (at < 0 || all < 2) return { width: 1.75 };
    return at ? { width: 2.5, dash: [7, 7 * at] } : { width: 2.5 };
  }

  private whatIsFlat(): string {
    const [begin, end] = this.range(), names = (this.told.fields ?? []).map((field) => field.name);
    return this.drawn.filter((name) => {
      const column = this.columns[names.indexOf(name)] ?? [];
      let low = Infinity, high = -Infinity;
      this.times.forEach((at, row) => { const value = column[row]; if (typeof value === "number" && at >= begin && at <= end) { low = Math.min(low, value); high = Math.max(high, value); } });
      return high >= low && high - low < 1e-9;
    }).join("\n");
  }

  private data(): uPlot.AlignedData {
    const names = (this.told.fields ?? []).map((field) => field.name);
    return [this.times, ...this.drawn.map((name) => this.columns[names.indexOf(name)] ?? [])] as uPlot.AlignedData;
  }

  private range(): [number, number] {
    const end = this.told.whole ? this.nowS : Math.max(this.nowS, this.times.at(-1) ?? 0);
    return this.still ?? [end - this.spanS, end];
  }

  /** Marks at whole seconds before the end, so that they stand still while the time goes on. */
  private marks(_: uPlot, low: number, high: number, step: number): number[] {
    if (this.still) return Array.from({ length: 40 }, (_, at) => (Math.ceil(low / step) + at) * step).filter((at) => at <= high);
    return Array.from({ length: 40 }, (_, at) => high - at * step).filter((at) => at >= low).reverse();
  }

  private timeText(at: number): string {
    const since = at - this.range()[1];
    if (this.still) return new Date(at * 1000).toTimeString().slice(0, 8);
    return since > -0.05 ? "now" : `${since.toFixed(Number.isInteger(Math.round(since * 1000) / 1000) ? 0 : 1)} s`;
  }

  /** Draws at most 15 times a second: the time goes on, also where nothing comes. */
  private draw(isNew: boolean): void {
    const now = performance.now();
    this.isNew ||= isNew;
    if (!this.plot || now - this.drawnAt < 66 || this.sheet.clientWidth < 40) return;
    this.drawnAt = now;
    const flat = this.isNew ? this.whatIsFlat() : this.flat;
    if (flat !== this.flat) { this.flat = flat; this.build(); }
    this.plot?.setData(this.data(), true);
    if (this.isNew) this.tellValues();
    this.isNew = false;
  }

  private tellValues(): void {
    const at = this.plot?.cursor.idx ?? null, fields = this.told.fields ?? [];
    fields.forEach((field, index) => {
      const column = this.columns[index] ?? [];
      let value: number | null | undefined = at === null ? undefined : column[at];
      for (let row = column.length - 1; at === null && row >= Math.max(0, column.length - 40) && (value === undefined || value === null); row--) value = column[row];
      const chip = this.chips.get(field.name)?.lastElementChild;
      if (chip) say(chip as HTMLElement, typeof value === "number" ? `${short(value)}${field.unit ? ` ${field.unit}` : ""}${this.bare.has(field.name) ? " (no axis)" : ""}` : "–");
    });
  }

  tick(nowS: number, lost: boolean): void {
    this.nowS = nowS;
    const at = this.told.at_s;
    if (at === undefined || at === null) return this.frame.tellAge("", false);
    const age = nowS - at, rate = this.told.rate_hz, isOld = lost || age > Math.max(2, rate ? 5 / rate : 2);
    const seen = this.still ? " · stands still (0 or double click: goes on)" : "";
    this.frame.tellAge(`${rateText(rate, isOld)}${ageText(age, this.told.from_before)}${seen}`, isOld);
    if (!this.still && !lost) this.draw(false);
    if (this.sheet.clientWidth && !lost) this.sheet.setAttribute("aria-label", this.inWords());
  }

  private inWords(): string {
    const fields = this.told.fields ?? [], [begin, end] = this.range();
    const said = this.drawn.map((name) => {
      const index = fields.findIndex((field) => field.name === name), unit = fields[index]?.unit ?? "";
      const values = (this.columns[index] ?? []).filter((value, row): value is number => typeof value === "number" && (this.times[row] ?? 0) >= begin && (this.times[row] ?? 0) <= end);
      if (!values.length) return `${name}: nothing came`;
      return `${name} ${short(values.at(-1) ?? 0)} ${unit}, between ${short(Math.min(...values))} and ${short(Math.max(...values))}`;
    });
    return `Plot of ${this.told.topic} over ${Math.round(end - begin)} seconds. ${said.join("; ")}`;
  }

  // ── where it looks ──────────────────────────────────────────────────────────────────────────────────────────────

  private look(at: [number, number] | null): void {
    this.still = at;
    this.drawnAt = 0;
    this.draw(true);
  }

  private press(event: KeyboardEvent): void {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const [begin, end] = this.range(), move = (end - begin) / 10, at = SPANS_S.indexOf(this.spanS);
    const steps: Record<string, () => void> = {
      "-": () => { this.spanS = SPANS_S[at + 1] ?? this.spanS; this.look(null); },
      "+": () => { this.spanS = SPANS_S[at - 1] ?? this.spanS; this.look(null); },
      Enter: () => this.pick((begin + end) / 2, event.shiftKey),
      "0": () => this.look(null), p: () => this.look(this.still ? null : [begin, end]),
      ArrowLeft: () => this.look([begin - move, end - move]), ArrowRight: () => this.look([begin + move, end + move]),
    };
    const step = steps[event.key === "=" ? "+" : event.key];
    if (step) { event.preventDefault(); step(); }
  }
}

/** The last two parts of a name, or as many as tell it from the others. */
function briefName(name: string, among: string[]): string {
  const parts = name.split(".");
  for (let most = 2; most < parts.length; most++) {
    const end = parts.slice(-most).join(".");
    if (among.filter((other) => other === end || other.endsWith(`.${end}`)).length === 1) return end;
  }
  return name;
}

/** How many axes a plot of that width has room for. */
const axesIn = (width: number): number => (width > 700 ? 4 : width > 480 ? 3 : 2);

function short(value: number): string {
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e6 || size < 1e-4) return value.toExponential(2);
  return String(Number(value.toFixed(size >= 1000 ? 1 : size >= 10 ? 2 : 4)));
}

export const kind: Kind = { title: "Plot", place: "values", order: 6, make: (section, { picks }) => new PlotPanel(section, picks) };
