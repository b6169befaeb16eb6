// Render diagrams: a JSON list of Mermaid texts on standard input, a JSON list of SVG elements on standard output.
import { text } from "node:stream/consumers";
import { renderMermaidSVG } from "beautiful-mermaid";

const sources = JSON.parse(await text(process.stdin));
const render = (source) => renderMermaidSVG(source, { fg: "currentColor", transparent: true });
// The library loads its font from the network; the site uses the system's fonts.
process.stdout.write(JSON.stringify(sources.map((source) => render(source).replace(/@import url\([^)]*\);/, ""))));
