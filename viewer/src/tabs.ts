// Panels that share a place: one is shown, the others are hidden, and so not asked for. And one panel as large as the page.

import { byId, make } from "./dom.ts";

const WAITING = "Waiting for the first answer."; // which all panels say at first

/** Gives each of these panels the names of all in place of its title; returns what shows one of them. */
export function share(panels: [id: string, title: string][]): (id: string) => void {
  const show = (id: string): void => {
    const isLarge = panels.some(([other]) => byId(other).classList.contains("large"));
    for (const [other] of panels) byId(other).hidden = other !== id;
    if (isLarge) enlarge(id);
  };
  for (const [id, title] of panels) {
    const tabs = make("div", { class: "tabs", role: "tablist" }, ...panels.map(([other, name]) => {
      const tab = make("button", { type: "button", role: "tab", "aria-selected": String(other === id), "aria-controls": other, tabindex: other === id ? "0" : "-1" }, name);
      tab.addEventListener("click", () => go(other));
      return tab;
    }));
    tabs.addEventListener("keydown", (event) => {
      const by = event.key === "ArrowRight" ? 1 : event.key === "ArrowLeft" ? -1 : 0;
      if (!by) return;
      event.preventDefault();
      const at = panels.findIndex(([other]) => other === id);
      go(panels[(at + by + panels.length) % panels.length]?.[0] ?? id);
    });
    const heading = byId(id).querySelector("h2");
    heading?.replaceWith(make("h2", { class: "unseen" }, title), tabs);
  }
  const go = (id: string): void => {
    show(id);
    byId(id).querySelector<HTMLElement>("[aria-selected=true]")?.focus();
  };
  show(panels[0]?.[0] ?? "");
  return show;
}

/** Folds a panel that has no source to its title and the reason, so that the others have its space. One that a person
 * can give a source stays as it is, and so does one that only waits. */
export function foldable(ids: string[]): void {
  for (const id of ids) {
    const panel = byId(id), why = panel.querySelector<HTMLElement>(".why"), choice = panel.querySelector("select");
    if (!why) continue;
    const fold = (): void => { panel.classList.toggle("bare", !why.hidden && why.textContent !== WAITING && (!choice || choice.hidden)); };
    const seen = new MutationObserver(fold);
    seen.observe(why, { attributes: true, childList: true, subtree: true, characterData: true });
    if (choice) seen.observe(choice, { attributes: true });
  }
}

/** A button in each head that makes the panel as large as the page, and back; the others cost nothing meanwhile. */
export function enlargeable(ids: string[]): void {
  for (const id of ids) {
    const button = make("button", { type: "button", class: "enlarge", title: "As large as the page (Esc: back)", "aria-label": "As large as the page", "aria-pressed": "false" }, "⤢");
    button.addEventListener("click", () => enlarge(byId(id).classList.contains("large") ? "" : id));
    byId(id).querySelector(".head")?.append(button);
  }
  document.addEventListener("keydown", (event) => { if (event.key === "Escape" && !(event.target instanceof HTMLSelectElement)) enlarge(""); });
}

function enlarge(id: string): void {
  const all = document.querySelectorAll<HTMLElement>("main > .panel");
  for (const panel of all) {
    panel.classList.toggle("large", panel.id === id);
    panel.querySelector(".enlarge")?.setAttribute("aria-pressed", String(panel.id === id));
  }
  document.body.classList.toggle("one", !!id);
}

/** Whether somebody can see a panel: what is hidden is not asked for. */
export const isSeen = (id: string): boolean => {
  const panel = document.getElementById(id);
  return !panel || panel.getClientRects().length > 0;
};
