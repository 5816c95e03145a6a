// The chat host around this page: MCP Apps, JSON-RPC 2.0 by postMessage. Nothing else is heard or answered.

const PROTOCOL = "2026-01-26";
const AGAIN_MS = 2000; // the outer frame of some hosts listens later than this page speaks
const START_MS = 2000; // for what the tool was called with, before the page begins without it
const LEAST_MS = 200, MOST_MS = 2000; // between two questions: each passes one or two processes of the host
const SLOW_MS = 500, QUICK_MS = 200;
const MOST_TEXT = 4000;
const PATIENCE_MS = 5000;

export type HostContext = {
  theme?: unknown; displayMode?: unknown; availableDisplayModes?: unknown;
  [name: string]: unknown;
};
type Fields = Record<string, unknown>;
type Waiting = { done: (value: unknown) => void; failed: (error: Error) => void; timer: number };
/** What `ros2_view` gives the page: the topics for its panels, and the time that is shown of a recording. */
export type Opened = { panels: Record<string, string>; atS: number | null };

const fields = (value: unknown): Fields => (value && typeof value === "object" && !Array.isArray(value) ? value as Fields : {});
const text = (value: unknown): string => (typeof value === "string" ? value : "");

export class Host {
  context: HostContext = {};
  can: Fields = {};
  state = "connecting to the chat";
  isEnded = false;
  isSeen = true;
  onContext: () => void = () => undefined;
  onClosing: () => void = () => undefined;
  onOpened: (opened: Opened) => void = () => undefined;
  /** The recording and the robot that the page is about; both empty for the only robot. */
  private about: { bag?: string; robot?: string } = {};
  private readonly waiting = new Map<number, Waiting>();
  private last = 0;
  private pace = LEAST_MS;
  private begin: () => void = () => undefined;
  private readonly begun = new Promise<void>((resolve) => { this.begin = resolve; });
  private sizeTimer = 0;

  constructor() {
    addEventListener("message", (event) => { if (event.source === window.parent) this.hear(fields(event.data)); });
    new IntersectionObserver((entries) => { this.isSeen = entries.at(-1)?.isIntersecting ?? true; }).observe(document.documentElement);
  }

  /** Shakes hands; ends when it is known what to show. */
  async start(): Promise<void> {
    const params = { protocolVersion: PROTOCOL, appInfo: { name: "ros2-mcp", version: "1" }, appCapabilities: { availableDisplayModes: ["inline", "fullscreen"] } };
    let answer: Fields | null = null;
    while (!answer && !this.isEnded) {
      try { answer = fields(await this.request("ui/initialize", params, AGAIN_MS)); } catch { this.state = "the chat does not answer this page"; }
    }
    this.can = fields(answer?.hostCapabilities);
    this.context = fields(answer?.hostContext);
    this.onContext();
    this.notify("ui/notifications/initialized", {});
    new ResizeObserver(() => this.tellSize()).observe(document.body);
    this.tellSize();
    if (!this.can.serverTools) this.state = "this chat lets no page ask its server: ros2-mcp view shows it in a browser";
    await Promise.race([this.begun, new Promise((resolve) => setTimeout(resolve, START_MS))]);
    if (this.state.startsWith("connecting")) this.state = "";
  }

  /** Calls a tool of our server; what it gives. The host's time is what the pace follows. */
  async callTool(name: string, args: Fields, patienceMs: number): Promise<unknown> {
    const began = performance.now();
    const result = fields(await this.request("tools/call", { name, arguments: { ...args, ...this.named(name) } }, patienceMs));
    if (result.isError) {
      const said = Array.isArray(result.content) ? result.content.map((block) => text(fields(block).text)).join(" ") : "";
      throw new Error(said.slice(0, 300) || "the server refused");
    }
    const given = result.structuredContent;
    if (!given || typeof given !== "object") throw new Error("the chat passes on no data");
    const took = performance.now() - began - (Number(fields(given).took_ms) || 0);
    if (took > SLOW_MS) this.pace = Math.min(this.pace * 2, MOST_MS);
    else if (took < QUICK_MS) this.pace = Math.max(this.pace * 0.8, LEAST_MS);
    return given;
  }

  /** How long to wait after the last question was put, before the next one. */
  get leastMs(): number { return this.pace; }

  get isFull(): boolean { return this.context.displayMode === "fullscreen"; }

  get canBeFull(): boolean { return Array.isArray(this.context.availableDisplayModes) && this.context.availableDisplayModes.includes("fullscreen"); }

  /** Asks for another size; the answer is the real one. */
  async change(mode: "inline" | "fullscreen"): Promise<void> {
    const answer = fields(await this.request("ui/request-display-mode", { mode }, PATIENCE_MS));
    if (text(answer.mode)) { this.context = { ...this.context, displayMode: answer.mode }; this.onContext(); }
  }

  get canSay(): boolean { return !!this.can.message; }

  /** What the model reads with its next turn, in place of what it was told before; not every host passes it on. */
  tellModel(lines: string[]): void {
    if (!this.can.updateModelContext) return;
    const content = lines.length ? [{ type: "text", text: lines.join("\n").slice(0, MOST_TEXT) }] : [];
    this.request("ui/update-model-context", { content }, PATIENCE_MS).catch(() => undefined);
  }

  /** A message in the name of the person, which only their click sends. */
  sayForUser(said: string): void {
    this.request("ui/message", { role: "user", content: [{ type: "text", text: said.slice(0, MOST_TEXT) }] }, PATIENCE_MS).catch(() => undefined);
  }

  private named(name: string): Fields {
    const { bag, robot } = this.about;
    return { ...(bag && name !== "ros2_view_stop" ? { bag } : {}), ...(robot ? { robot } : {}) };
  }

  private request(method: string, params: Fields, patienceMs: number): Promise<unknown> {
    if (this.isEnded) return Promise.reject(new Error("this page was closed"));
    const id = ++this.last;
    return new Promise((done, failed) => {
      const timer = window.setTimeout(() => { this.waiting.delete(id); failed(new Error("no answer in time")); }, patienceMs);
      this.waiting.set(id, { done, failed, timer });
      this.post({ id, method, params });
    });
  }

  private notify(method: string, params: Fields): void { this.post({ method, params }); }

  /** The host's origin is not known to a page; nothing that is secret is ever said. */
  private post(message: Fields): void { window.parent.postMessage({ jsonrpc: "2.0", ...message }, "*"); }

  private hear(message: Fields): void {
    if (message.jsonrpc !== "2.0") return;
    const id = message.id as number | undefined;
    if (typeof message.method === "string") {
      const answer = this.answer(message.method, fields(message.params));
      if (id !== undefined && id !== null) this.post({ id, ...(answer ? { result: answer } : { error: { code: -32601, message: "There is no such method." } }) });
      return;
    }
    const waiting = id === undefined ? undefined : this.waiting.get(id);
    if (!waiting || id === undefined) return;
    this.waiting.delete(id);
    clearTimeout(waiting.timer);
    if (message.error) waiting.failed(new Error(text(fields(message.error).message).slice(0, 300) || "the chat refused"));
    else waiting.done(message.result);
  }

  /** What the host asks or tells; null for what is not known. */
  private answer(method: string, params: Fields): Fields | null {
    if (method === "ui/notifications/host-context-changed") { this.context = { ...this.context, ...params }; this.onContext(); return {}; }
    if (method === "ui/notifications/tool-input") { this.take(fields(params.arguments)); this.begin(); return {}; }
    if (method === "ui/notifications/tool-result") { this.takeResult(fields(params.structuredContent)); this.begin(); return {}; }
    if (method === "ui/notifications/tool-cancelled") { this.end("the call was cancelled"); return {}; }
    if (method === "ui/notifications/tool-input-partial" || method === "ping") return {};
    if (method === "ui/resource-teardown") { this.onClosing(); this.end("closed"); return {}; }
    return null;
  }

  private take(given: Fields): void {
    if (text(given.bag)) this.about.bag = text(given.bag);
    if (text(given.robot)) this.about.robot = text(given.robot);
  }

  private takeResult(given: Fields): void {
    this.take(given);
    const panels = Object.fromEntries(Object.entries(fields(given.panels)).map(([name, topic]) => [name, text(topic).slice(0, MOST_TEXT)]));
    this.onOpened({ panels, atS: typeof given.at_s === "number" ? given.at_s : null });
  }

  private end(why: string): void {
    this.isEnded = true;
    this.state = why;
    this.begin();
    for (const { failed, timer } of this.waiting.values()) { clearTimeout(timer); failed(new Error(why)); }
    this.waiting.clear();
  }

  private tellSize(): void {
    clearTimeout(this.sizeTimer);
    this.sizeTimer = window.setTimeout(() => {
      if (!this.isEnded) this.notify("ui/notifications/size-changed", { width: Math.ceil(document.body.scrollWidth), height: Math.ceil(document.body.getBoundingClientRect().height) });
    }, 100);
  }
}
