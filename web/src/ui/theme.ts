/** Dark or light: the system's choice until the user makes one. */

export type Theme = "dark" | "light";

const KEY = "isopeel.theme";
const system = window.matchMedia("(prefers-color-scheme: light)");

function stored(): Theme | undefined {
  try {
    const value = localStorage.getItem(KEY);
    return value === "dark" || value === "light" ? value : undefined;
  } catch {
    // Storage may be forbidden; the choice then lasts as long as the page.
    return undefined;
  }
}

let chosen = stored();

/** The one in force. */
export function theme(): Theme {
  return chosen ?? (system.matches ? "light" : "dark");
}

/** Applies the theme now and whenever the system's changes. */
export function followTheme(onChange: (theme: Theme) => void): void {
  const apply = () => {
    document.documentElement.dataset["theme"] = theme();
    onChange(theme());
  };
  system.addEventListener("change", apply);
  document.addEventListener("isopeel-theme", apply);
  apply();
}

export function toggleTheme(): void {
  const next: Theme = theme() === "dark" ? "light" : "dark";
  // Back at the system's choice, follow it again.
  chosen = next === (system.matches ? "light" : "dark") ? undefined : next;
  try {
    if (chosen === undefined) localStorage.removeItem(KEY);
    else localStorage.setItem(KEY, chosen);
  } catch {
    // Storage may be forbidden.
  }
  document.dispatchEvent(new Event("isopeel-theme"));
}
