"""Template and script of the viewer. `content` says what is there; its voxels are in elements of their own."""

STYLE = """:root { color-scheme: dark; }
body { font: 15px/1.45 system-ui, sans-serif; margin: 0; background: #16181b; color: #e6e6e6; }
header, main, footer { max-width: 78rem; margin: 0 auto; padding: 0 1rem; }
h1 { font-size: 1.25rem; margin: .8rem 0 .1rem; } p { margin: .2rem 0 .6rem; } .note { color: #a9adb3; }
#controls { position: sticky; top: 0; background: #16181bf2; z-index: 1; padding: .5rem 0; display: grid;
grid-template-columns: repeat(auto-fit, minmax(min(100%, 15rem), 1fr)); gap: .35rem 1.2rem; }
#controls label { display: grid; grid-template-columns: 5.2rem 1fr 4.6rem; align-items: center; gap: .5rem; }
#controls input[type=range] { width: 100%; min-width: 0; accent-color: #56B4E9; }
#controls select { grid-column: 2 / 4; width: 100%; min-width: 0; font: inherit; background: #24272c; color: inherit;
border: 1px solid #4a4f57; border-radius: 4px; padding: .15rem; }
output { text-align: right; font-variant-numeric: tabular-nums; }
#panels { display: grid; gap: .6rem; grid-template-columns: repeat({{ content.reconstructions|length + 1 }}, 1fr);
grid-auto-flow: column; grid-template-rows: repeat(2, auto); }
#legend { align-self: center; font-size: .85rem; }
figure { margin: 0; } figcaption { font-size: .85rem; display: flex; justify-content: space-between; gap: .5rem; }
figcaption output { color: #F0E442; white-space: nowrap; }
canvas { width: 100%; display: block; background: #000; touch-action: pan-y; cursor: crosshair; }
#rois { display: flex; flex-wrap: wrap; gap: .2rem 1rem; margin: .6rem 0; }
#rois i { display: inline-block; width: .8em; height: .8em; margin-right: .35em; border-radius: 2px; }
#problem { background: #7a2d00; padding: .5rem .8rem; }
#bar { height: .6rem; border-radius: 2px; }
@media (max-width: 40rem) {
  #panels { grid-template-columns: 1fr 1fr; grid-auto-flow: row; grid-template-rows: none; }
  #controls { position: static; } #controls label:first-child { position: sticky; top: 0; }
}
"""

BODY = """<header><h1>Slices of the study</h1>
<p class="note">{{ subtitle }}{% if thinned %} To keep this page small it holds every {{ thinned[0] }}. slice and every
{{ thinned[1] }}. voxel of a row and column.{% endif %}</p>
<p id="problem" hidden></p></header>
<main>
<div id="controls">
<label>Slice <input id="slice" type="range" min="0" max="{{ content.shape[0] - 1 }}" value="{{ content.first_slice }}">
<output id="slice_text"></output></label>
<label>Level <input id="level" type="range" min="-1000" max="1500" step="5" value="40">
<output id="level_text"></output></label>
<label>Width <input id="width" type="range" min="10" max="3000" step="10" value="400">
<output id="width_text"></output></label>
<label>Difference <input id="limit" type="range" min="5" max="1000" step="5" value="100">
<output id="limit_text"></output></label>
<label>Window <select id="preset"><option value="40,400">abdomen (40, 400 HU)</option>
<option value="60,150">liver (60, 150 HU)</option><option value="-600,1500">lung (−600, 1500 HU)</option>
<option value="400,1800">bone (400, 1800 HU)</option><option value="0,2000">everything (0, 2000 HU)</option>
<option value="">as set</option></select></label>
<label>Scans <select id="part"><option value="one">one scan</option>
<option value="mean">mean of repeats</option></select></label>
<label>Regions <select id="outlines"><option value="1">outlined</option>
<option value="">hidden</option></select></label>
</div>
<div id="panels"></div>
<div id="legend"><p class="note" id="place"></p><div id="bar"></div>
<p class="note" id="bar_text"></p><div id="rois"></div></div>
</main>
<footer><p class="note">The patient's right is on the left, anterior at the top. Wheel, arrow keys or the slider change
the slice; hold and drag on an image for level (up and down) and width (left and right); point or tap for CT numbers.
Values are whole HU.</p></footer>
{% for name, text in packed.items() %}<script type="text/plain" id="data_{{ name }}">{{ text }}</script>
{% endfor %}"""

SCRIPT = """"use strict";
const content = {{ content|tojson }};
const [depth, height, width] = content.shape, area = height * width;
const zoom = Math.max(1, Math.round(512 / width));
const element = (id) => document.getElementById(id);
const volumes = {}, panels = [];
let rois, pointed = null;

async function unpack(name, kind) {
  const text = atob(element("data_" + name).textContent.trim());
  const bytes = Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new kind(await new Response(stream).arrayBuffer());
}

function panel(title, value, difference) {
  const figure = document.createElement("figure"), caption = document.createElement("figcaption");
  const canvas = document.createElement("canvas"), name = document.createElement("span");
  const reading = document.createElement("output");
  canvas.width = width * zoom; canvas.height = height * zoom;
  canvas.style.aspectRatio = width * content.spacing[2] + " / " + height * content.spacing[1];
  canvas.setAttribute("role", "img"); canvas.setAttribute("aria-label", title);
  name.textContent = title; caption.append(name, reading); figure.append(caption, canvas);
  element("panels").append(figure);
  panels.push({canvas, value, difference, reading});
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault(); move(Math.sign(event.deltaY)); }, {passive: false});
  let start = null;
  canvas.addEventListener("pointerdown", (event) => {
    start = {x: event.clientX, y: event.clientY, level: +element("level").value, width: +element("width").value,
      limit: +element("limit").value};
    if (event.pointerType === "mouse") canvas.setPointerCapture(event.pointerId);
    point(event); });
  canvas.addEventListener("pointermove", (event) => {
    if (start && event.buttons && event.pointerType === "mouse") {
      const right = event.clientX - start.x, up = start.y - event.clientY;
      if (difference) element("limit").value = start.limit + right;
      else { element("level").value = start.level + 2 * up; element("width").value = start.width + 4 * right;
        element("preset").value = ""; }
      draw();
    }
    point(event); });
  canvas.addEventListener("pointerup", () => { start = null; });
  canvas.addEventListener("pointerleave", () => { pointed = null; read(); });
}

function point(event) {
  const box = event.target.getBoundingClientRect();
  const column = Math.floor((event.clientX - box.left) / box.width * width);
  const line = Math.floor((event.clientY - box.top) / box.height * height);
  pointed = column >= 0 && column < width && line >= 0 && line < height ? line * width + column : null;
  read();
}

function read() {
  const z = +element("slice").value;
  for (const one of panels) one.reading.textContent =
    pointed === null ? "" : String(one.value(z * area + pointed)).replace("-", "−") + " HU";
}

function move(by) {
  const slider = element("slice");
  slider.value = +slider.value + by; draw();
}

// Blue below, white at zero, red above.
function diverging(share) {
  const s = Math.max(-1, Math.min(1, share)), end = s < 0 ? [33, 102, 172] : [178, 24, 43], a = Math.abs(s);
  return end.map((c) => 247 + (c - 247) * a);
}

const small = document.createElement("canvas");
small.width = width; small.height = height;

function draw() {
  const z = +element("slice").value, offset = z * area;
  const level = +element("level").value, wide = +element("width").value, limit = +element("limit").value;
  for (const one of panels) {
    const context = small.getContext("2d"), image = context.createImageData(width, height);
    for (let i = 0; i < area; i++) {
      const value = one.value(offset + i);
      let colour;
      if (one.difference) colour = diverging(value / limit);
      else { const grey = 255 * Math.max(0, Math.min(1, (value - level) / wide + 0.5)); colour = [grey, grey, grey]; }
      image.data.set([colour[0], colour[1], colour[2], 255], 4 * i);
    }
    context.putImageData(image, 0, 0);
    const large = one.canvas.getContext("2d");
    large.imageSmoothingEnabled = false;
    large.drawImage(small, 0, 0, width * zoom, height * zoom);
    if (element("outlines").value) outline(large, offset);
  }
  element("slice_text").textContent = z + 1 + " of " + depth;
  element("level_text").textContent = level + " HU";
  element("width_text").textContent = wide + " HU";
  element("limit_text").textContent = "± " + limit + " HU";
  element("place").textContent = "z = " + String(content.slices_mm[z]).replace("-", "−") + " mm";
  element("bar_text").textContent = "Differences: blue −" + limit + " HU, white 0, red +" + limit + " HU.";
  read();
}

function outline(context, offset) {
  context.lineWidth = Math.max(1, zoom / 2);
  content.rois.forEach((roi, index) => {
    const inside = (line, column) => line >= 0 && line < height && column >= 0 && column < width &&
      rois[offset + line * width + column] === index + 1;
    context.strokeStyle = roi.colour;
    context.beginPath();
    for (let line = 0; line < height; line++) for (let column = 0; column < width; column++) {
      if (!inside(line, column)) continue;
      const x = column * zoom, y = line * zoom;
      if (!inside(line - 1, column)) { context.moveTo(x, y); context.lineTo(x + zoom, y); }
      if (!inside(line + 1, column)) { context.moveTo(x, y + zoom); context.lineTo(x + zoom, y + zoom); }
      if (!inside(line, column - 1)) { context.moveTo(x, y); context.lineTo(x, y + zoom); }
      if (!inside(line, column + 1)) { context.moveTo(x + zoom, y); context.lineTo(x + zoom, y + zoom); }
    }
    context.stroke();
  });
}

async function begin() {
  volumes.input = await unpack("input", Int16Array);
  rois = await unpack("rois", Uint8Array);
  for (const one of content.reconstructions) for (const part of ["one", "mean"])
    volumes[one.key + "_" + part] = await unpack(one.key + "_" + part, Int16Array);
  const chosen = (key) => volumes[key + "_" + element("part").value];
  panel("Input", (i) => volumes.input[i], false);
  element("panels").append(element("legend"));
  for (const one of content.reconstructions) {
    panel(one.title, (i) => chosen(one.key)[i], false);
    panel(one.title.split(",")[0] + " − input", (i) => chosen(one.key)[i] - volumes.input[i], true);
  }
  const stops = [-1, -0.5, 0, 0.5, 1].map((share) => "rgb(" + diverging(share).map(Math.round).join() + ")");
  element("bar").style.background = "linear-gradient(to right, " + stops.join(", ") + ")";
  for (const roi of content.rois) {
    const chip = document.createElement("span"), patch = document.createElement("i");
    patch.style.background = roi.colour; chip.append(patch, roi.name); element("rois").append(chip);
  }
  const repeats = Math.min(...content.reconstructions.map((one) => one.repeats));
  element("part").options[1].textContent = "mean of " + repeats + " repeats: less noise";
  for (const id of ["slice", "limit", "part", "outlines"]) element(id).addEventListener("input", draw);
  for (const id of ["level", "width"]) element(id).addEventListener("input", () => {
    element("preset").value = ""; draw(); });
  element("preset").addEventListener("input", () => {
    if (!element("preset").value) return;
    [element("level").value, element("width").value] = element("preset").value.split(","); draw(); });
  addEventListener("keydown", (event) => {
    if (/^(INPUT|SELECT)$/.test(event.target.tagName)) return;
    const by = {ArrowUp: 1, ArrowRight: 1, PageUp: 5, ArrowDown: -1, ArrowLeft: -1, PageDown: -5}[event.key];
    if (by) { event.preventDefault(); move(by); } });
  draw();
  document.body.dataset.ready = "yes";
}

begin().catch((error) => {
  element("problem").hidden = false;
  element("problem").textContent = typeof DecompressionStream === "undefined"
    ? "This browser is too old to unpack the images: it takes Chrome 80, Firefox 113, Safari 16.4 or later."
    : "The images cannot be shown: " + error;
});
"""

PAGE = (
    """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Slices of the study</title>
<style>
"""
    + STYLE
    + "</style></head><body>\n"
    + BODY
    + "<script>\n"
    + SCRIPT
    + "</script>\n"
)
