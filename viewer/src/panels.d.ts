// The files of panels/, by name: build.mjs makes this module.

declare module "panels" {
  const kinds: Record<string, import("./panel.ts").Kind>;
  export default kinds;
}
