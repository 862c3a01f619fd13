import { App } from "./app";
import { h } from "./ui/dom";
import "./ui/style/base.css";
import "./ui/style/picture.css";
import "./ui/style/panel.css";
import "./ui/style/choices.css";
import "./ui/style/plots.css";
import "./ui/style/status.css";
import "./ui/style/narrow.css";

const root = document.getElementById("app");
if (root === null) throw new Error("index.html has no element #app");
try {
  new App(root, new URL(".", window.location.href)).start();
} catch (error) {
  const reason = error instanceof Error ? error.message : String(error);
  root.replaceChildren(
    h("div", { class: "fatal", role: "alert" }, h("h1", {}, "isopeel cannot draw here"), h("p", {}, `It needs WebGL 2. The browser says: ${reason}`)),
  );
}
