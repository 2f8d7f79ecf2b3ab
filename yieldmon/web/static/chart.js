// A line with a band of one standard deviation, by uPlot.

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

const MINUTE = 60;
const DAY = 86400;

// Twenty-four hours, and no more than the axis' steps resolve.
function moment(seconds, step) {
  const text = new Date(1000 * seconds).toLocaleString("sv");
  return step >= DAY ? text.slice(2, 10) : text.slice(11, step >= MINUTE ? 16 : 19);
}

export class BandChart {
  #plot;
  #element;
  #moments = 0;

  constructor(element, { height = 0, steps = false, points = false } = {}) {
    this.#element = element;
    const ink = () => colour("--ink");
    const axis = { stroke: ink, grid: { stroke: () => colour("--line"), width: 0.5 }, ticks: { stroke: ink }, font: "14px system-ui" };
    const paths = steps ? uPlot.paths.stepped({ align: 1 }) : undefined;
    const edge = { stroke: "transparent", points: { show: false }, paths };
    this.#plot = new uPlot(
      {
        ...this.#size(height),
        legend: { show: false },
        cursor: { show: false },
        scales: { x: { time: true, range: (_, from, to) => this.#span(from, to) }, y: { range: (_, low, high) => this.#range(low, high) } },
        axes: [{ ...axis, space: 80, values: (_, at, __, ___, step) => at.map((seconds) => moment(seconds, step)) }, { ...axis, size: 56 }],
        series: [
          {},
          { stroke: () => colour("--accent"), width: 2, points: { show: points }, paths },
          edge, edge,
        ],
        bands: [{ series: [2, 3], fill: () => `${colour("--accent")}40` }],
      },
      [[], [], [], []],
      element,
    );
    new ResizeObserver(() => this.#plot.setSize(this.#size(height))).observe(element);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.#plot.redraw(false, true));
  }

  #size(height) {
    return { width: Math.max(50, this.#element.clientWidth), height: height || Math.max(50, this.#element.clientHeight) };
  }

  // Around one moment alone the days beside it: by itself uPlot shows years.
  #span(from, to) {
    const [first, last] = this.#moments === 1 ? [from - DAY, from + DAY] : [from, to];
    this.#element.dataset.seconds = last - first;
    return [first, last];
  }

  #range(low, high) {
    if (low === null || high === null) return [0, 1];
    const margin = 0.05 * (high - low) || 0.05 * Math.abs(high) || 1;
    return [low - margin, high + margin];
  }

  // time: Unix seconds; value and deviation: null where not known.
  show(time, value, deviation) {
    const side = (sign) => value.map((v, i) => (v === null || deviation[i] === null ? null : v + sign * deviation[i]));
    this.#moments = time.length;
    this.#plot.setData([time, value, side(1), side(-1)]);
  }
}
