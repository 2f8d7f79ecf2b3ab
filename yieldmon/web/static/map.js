// Points of a field on a canvas, with pan and zoom by touch, mouse and keyboard, and background tiles where there are some.
// Positions are kept in the Web Mercator plane, in which the tiles are: 0 to 1 from west to east and from north to south.

import { make, number } from "./ui.js";

// Viridis (van der Walt and Smith, CC0), in equal steps.
const COLOURS = [
  "#440154", "#481567", "#482677", "#453781", "#404788", "#39568c", "#33638d", "#2d708e", "#287d8e", "#238a8d", "#1f968b",
  "#20a387", "#29af7f", "#3cbb75", "#55c667", "#73d055", "#95d840", "#b8de29", "#dce319", "#fde725",
];
const PIXELS = new Uint32Array(COLOURS.map((text) => {
  const value = parseInt(text.slice(1), 16);
  return (0xff000000 | ((value & 0xff) << 16) | (value & 0xff00) | (value >> 16)) >>> 0;
}));
const EARTH_M = 40075016.7;
const POINT_M = 6;
const MOST_TILES = 256;

const mercatorX = (longitude) => longitude / 360 + 0.5;
const mercatorY = (latitude) => 0.5 - Math.asinh(Math.tan((latitude * Math.PI) / 180)) / (2 * Math.PI);

export class FieldMap {
  #box; #canvas; #context; #layer; #scale; #empty;
  #x = new Float64Array(4096); #y = new Float64Array(4096); #value = new Float32Array(4096);
  #count = 0; #low = 0; #high = 1; #rangedAt = 0;
  #view = { x: 0.5, y: 0.5, pixels: 256 };
  #follows = true;
  #pending = false;
  #fingers = new Map();
  #tiles; #pictures = new Map();
  #unit;

  // unit: of the flow, with its name and its worth in kg/s.
  constructor(box, { tiles = null, name = "Map", unit = { name: "kg/s", si: 1 } } = {}) {
    this.#box = box;
    this.#unit = unit;
    this.#tiles = tiles;
    this.#canvas = make("canvas");
    this.#canvas.tabIndex = 0;
    this.#canvas.setAttribute("role", "img");
    this.#canvas.setAttribute("aria-label", `${name}: no points yet`);
    this.#canvas.dataset.name = name;
    this.#context = this.#canvas.getContext("2d");
    this.#layer = document.createElement("canvas");
    const buttons = make("div", "", "zoom");
    const button = (text, label, act) => {
      const made = make("button", text);
      made.type = "button";
      made.setAttribute("aria-label", label);
      made.addEventListener("click", act);
      buttons.append(made);
    };
    button("+", "Zoom in", () => this.#zoom(2));
    button("−", "Zoom out", () => this.#zoom(0.5));
    button("▣", "Show all", () => this.fit());
    this.#scale = make("p");
    this.#empty = make("p", "No positions yet", "note");
    box.replaceChildren(this.#canvas, buttons, this.#scale, this.#empty);
    if (tiles?.attribution) this.#empty.after(make("p", tiles.attribution, "note"));
    this.#listen();
    new ResizeObserver(() => (this.#follows ? this.fit() : this.#later())).observe(box);
  }

  get points() { return this.#count; }

  clear() {
    this.#count = 0;
    this.#rangedAt = 0;
    this.#follows = true;
    this.#later();
  }

  // Degrees and kg/s.
  add(longitude, latitude, value) {
    if (this.#count === this.#x.length) this.#grow(2 * this.#count);
    const x = mercatorX(longitude);
    // Beside the first point, also across the 180th meridian.
    this.#x[this.#count] = this.#count ? x - Math.round(x - this.#x[0]) : x;
    this.#y[this.#count] = mercatorY(latitude);
    this.#value[this.#count++] = value;
  }

  addAll({ longitude, latitude, flow }) {
    const needed = this.#count + flow.length;
    if (needed > this.#x.length) this.#grow(needed);
    for (let i = 0; i < flow.length; i++) this.add(longitude[i] * 1e-7, latitude[i] * 1e-7, flow[i]);
    this.show();
  }

  setUnit(unit) {
    this.#unit = unit;
    if (this.#count) this.#range();
    this.#later();
  }

  #shown(value) {
    const shown = value / this.#unit.si;
    return number(shown, shown < 100 ? 1 : 0);
  }

  show() {
    if (this.#count > 1.1 * this.#rangedAt || this.#count < this.#rangedAt) this.#range();
    if (this.#follows) this.fit();
    else this.#later();
  }

  fit() {
    this.#follows = true;
    if (this.#count) {
      let [west, east, north, south] = [1, 0, 1, 0];
      for (let i = 0; i < this.#count; i++) {
        west = Math.min(west, this.#x[i]); east = Math.max(east, this.#x[i]);
        north = Math.min(north, this.#y[i]); south = Math.max(south, this.#y[i]);
      }
      const least = 50 / EARTH_M;
      const [width, height] = [Math.max(east - west, least), Math.max(south - north, least)];
      const pixels = 0.9 * Math.min(this.#box.clientWidth / width, this.#box.clientHeight / height);
      this.#view = { x: (west + east) / 2, y: (north + south) / 2, pixels };
    }
    this.#later();
  }

  #grow(size) {
    const copy = (Type, from) => { const to = new Type(size); to.set(from.subarray(0, this.#count)); return to; };
    this.#x = copy(Float64Array, this.#x);
    this.#y = copy(Float64Array, this.#y);
    this.#value = copy(Float32Array, this.#value);
  }

  // Colours span the middle 96 % of the values.
  #range() {
    const sorted = this.#value.slice(0, this.#count).sort();
    this.#low = sorted[Math.floor(0.02 * (this.#count - 1))] ?? 0;
    this.#high = Math.max(sorted[Math.ceil(0.98 * (this.#count - 1))] ?? 1, this.#low + 1e-3);
    this.#rangedAt = this.#count;
    const name = this.#canvas.dataset.name;
    const span = `${this.#shown(this.#low)} to ${this.#shown(this.#high)} ${this.#unit.name}`;
    this.#canvas.setAttribute("aria-label", `${name}: ${number(this.#count)} points, ${span}, dark is low, light is high`);
  }

  #zoom(factor, at = { x: this.#box.clientWidth / 2, y: this.#box.clientHeight / 2 }) {
    this.#follows = false;
    const [dx, dy] = [at.x - this.#box.clientWidth / 2, at.y - this.#box.clientHeight / 2];
    const pixels = Math.min(2 ** 31, Math.max(256, this.#view.pixels * factor));
    this.#view.x += dx / this.#view.pixels - dx / pixels;
    this.#view.y += dy / this.#view.pixels - dy / pixels;
    this.#view.pixels = pixels;
    this.#later();
  }

  #pan(dx, dy) {
    this.#follows = false;
    this.#view.x -= dx / this.#view.pixels;
    this.#view.y -= dy / this.#view.pixels;
    this.#later();
  }

  #listen() {
    const canvas = this.#canvas;
    const keys = {
      ArrowLeft: () => this.#pan(60, 0), ArrowRight: () => this.#pan(-60, 0), ArrowUp: () => this.#pan(0, 60),
      ArrowDown: () => this.#pan(0, -60), "+": () => this.#zoom(2), "=": () => this.#zoom(2), "-": () => this.#zoom(0.5),
      0: () => this.fit(),
    };
    canvas.addEventListener("keydown", (event) => {
      const act = keys[event.key];
      if (act && !event.ctrlKey && !event.metaKey && !event.altKey) { event.preventDefault(); act(); }
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.#zoom(2 ** (-event.deltaY / 300), { x: event.offsetX, y: event.offsetY });
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.#fingers.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
    });
    canvas.addEventListener("pointermove", (event) => this.#drag(event));
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => this.#fingers.delete(event.pointerId));
  }

  #drag(event) {
    const before = this.#fingers.get(event.pointerId);
    if (!before) return;
    const now = { x: event.offsetX, y: event.offsetY };
    const others = [...this.#fingers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
    if (others.length) {
      const [other] = others;
      const length = (place) => Math.hypot(place.x - other.x, place.y - other.y) || 1;
      this.#zoom(length(now) / length(before), { x: (now.x + other.x) / 2, y: (now.y + other.y) / 2 });
    } else {
      this.#pan(now.x - before.x, now.y - before.y);
    }
    this.#fingers.set(event.pointerId, now);
  }

  #later() {
    if (this.#pending) return;
    this.#pending = true;
    requestAnimationFrame(() => { this.#pending = false; this.#draw(); });
  }

  #draw() {
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [this.#box.clientWidth, this.#box.clientHeight].map((size) => Math.max(1, Math.round(size * ratio)));
    for (const canvas of [this.#canvas, this.#layer]) {
      if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    }
    this.#context.clearRect(0, 0, width, height);
    const scale = this.#view.pixels * ratio;
    const [left, top] = [this.#view.x * scale - width / 2, this.#view.y * scale - height / 2];
    if (this.#tiles) this.#drawTiles(scale, left, top, width, height);
    this.#drawPoints(scale, left, top, width, height);
    this.#context.drawImage(this.#layer, 0, 0);
    this.#empty.hidden = this.#count > 0;
    this.#scale.hidden = this.#count === 0;
    this.#scale.textContent = `dark ${this.#shown(this.#low)}, light ${this.#shown(this.#high)} ${this.#unit.name}`;
    this.#canvas.dataset.points = String(this.#count);
    this.#canvas.dataset.drawn = String(Number(this.#canvas.dataset.drawn ?? 0) + 1);
  }

  // Written pixel by pixel: a hundred thousand rectangles would take a canvas a tenth of a second.
  #drawPoints(scale, left, top, width, height) {
    const context = this.#layer.getContext("2d");
    const image = context.createImageData(width, height);
    const pixels = new Uint32Array(image.data.buffer);
    const metre = scale / (EARTH_M * Math.cos(Math.atan(Math.sinh(Math.PI * (1 - 2 * this.#view.y)))));
    const size = Math.max(2, Math.min(24, Math.round(POINT_M * metre)));
    const half = size >> 1;
    const classes = PIXELS.length / (this.#high - this.#low);
    for (let i = 0; i < this.#count; i++) {
      const x = Math.round(this.#x[i] * scale - left) - half;
      const y = Math.round(this.#y[i] * scale - top) - half;
      if (x < 0 || y < 0 || x + size > width || y + size > height) continue;
      const colour = PIXELS[Math.max(0, Math.min(PIXELS.length - 1, Math.floor((this.#value[i] - this.#low) * classes)))];
      for (let row = y * width + x, end = row + size * width; row < end; row += width) pixels.fill(colour, row, row + size);
    }
    context.putImageData(image, 0, 0);
  }

  #drawTiles(scale, left, top, width, height) {
    const [low, high] = this.#tiles.zooms;
    const zoom = Math.max(low, Math.min(high, Math.round(Math.log2(scale / 256))));
    const size = scale / 2 ** zoom;
    const tiles = 2 ** zoom;
    const range = (from, length) => [Math.floor(from / size), Math.floor((from + length) / size)];
    const [west, east] = range(left, width);
    const [north, south] = range(top, height).map((row) => Math.max(0, Math.min(tiles - 1, row)));
    if ((east - west + 1) * (south - north + 1) > MOST_TILES) return;
    for (let column = west; column <= east; column++) {
      for (let row = north; row <= south; row++) {
        const picture = this.#picture(`/tiles/${zoom}/${((column % tiles) + tiles) % tiles}/${row}`);
        if (picture.complete && picture.naturalWidth) {
          this.#context.drawImage(picture, column * size - left, row * size - top, size + 0.5, size + 0.5);
        }
      }
    }
  }

  #picture(address) {
    let picture = this.#pictures.get(address);
    if (picture) this.#pictures.delete(address);
    else {
      picture = new Image();
      picture.onload = () => this.#later();
      picture.src = address;
    }
    this.#pictures.set(address, picture);
    if (this.#pictures.size > MOST_TILES) this.#pictures.delete(this.#pictures.keys().next().value);
    return picture;
  }
}
