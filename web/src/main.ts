import { App } from "./app";
import { enter, takeRefusal, withoutToken } from "./net/session";
import { showNoWebGl } from "./ui/noWebGl";
import "./ui/style/base.css";
import "./ui/style/page.css";
import "./ui/style/picture.css";
import "./ui/style/cards.css";
import "./ui/style/widgets.css";
import "./ui/style/plots.css";
import "./ui/style/over.css";
import "./ui/style/narrow.css";

const root = document.getElementById("app");
if (root === null) throw new Error("index.html has no element #app");
const base = new URL(".", window.location.href);
await enter(base);
takeRefusal();
// Before the address is read as a link.
window.addEventListener("hashchange", () => {
  if (withoutToken(window.location.href).token !== undefined) void enter(base).then(() => window.location.reload());
});
// It says that the page is loading.
root.replaceChildren();
try {
  new App(root, base).start();
} catch (error) {
  showNoWebGl(root, base, error instanceof Error ? error.message : String(error));
}
