// SPDX-License-Identifier: Apache-2.0
// Charts over time with uPlot: one column a vehicle, equal scales along a row, one cursor for all.
import uPlot from "uplot";
import uplotStyle from "uplot/dist/uPlot.min.css";
import { colour, onScheme } from "./theme.js";

const HEIGHT_PX = 212;
const FEW = 40; // lines with fewer points show them
const ROUND = [1, 2, 5, 10]; // ends of a logarithmic axis within a power of ten
const FONT = "12px system-ui, sans-serif";
const charts = new Set();

/** Draws every figure of the page; the clock's time is a vertical line in all. */
export function drawFigures(figures, clock) {
  const style = document.createElement("style");
  style.textContent = uplotStyle;
  document.head.prepend(style);
  const span = timeSpan(Object.values(figures).flatMap((figure) => figure.cells));
  for (const holder of document.querySelectorAll("[data-figure]")) {
    const figure = figures[holder.dataset.figure];
    const ranges = rowRanges(figure.cells);
    for (const cell of figure.cells) holder.append(drawCell(figure, cell, ranges, span, clock));
  }
  onScheme(() => charts.forEach((chart) => chart.redraw()));
  let waiting = false;
  clock.subscribe(() => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      charts.forEach((chart) => { if (isNear(chart.root)) chart.redraw(false); });
    });
  });
  window.addEventListener("scroll", () => charts.forEach((chart) => { if (isNear(chart.root)) chart.redraw(false); }), { passive: true });
}

function isNear(element) {
  const box = element.getBoundingClientRect();
  return box.bottom > 0 && box.top < window.innerHeight;
}

function drawCell(figure, cell, ranges, span, clock) {
  const element = document.createElement("div");
  const title = document.createElement("h3");
  title.textContent = cell.title;
  element.append(title);
  cell.charts.forEach((chart, row) => {
    const holder = document.createElement("div");
    holder.className = "chart";
    holder.setAttribute("role", "img");
    holder.setAttribute("aria-label", describe(figure, cell, chart));
    element.append(holder);
    queueMicrotask(() => charts.add(drawChart(holder, chart, { range: ranges[row], span }, clock)));
  });
  return element;
}

function drawChart(holder, chart, { range, span }, clock) {
  const tables = chart.lines.map((line) => [line.x, line.y]);
  const data = tables.length ? uPlot.join(tables) : [[]];
  const options = {
    width: holder.clientWidth,
    height: HEIGHT_PX,
    cursor: { sync: { key: "time", scales: ["x", null] }, y: false, drag: { x: true, y: false } },
    legend: { live: true },
    scales: {
      x: { time: false, range: (u, low, high) => (isWhole(u, low, high) ? span : [low, high]) },
      y: { distr: chart.log ? 3 : 1, range: () => range },
    },
    axes: [axis("Time [s]", 30), axis(chart.title, 50)],
    series: [{ label: "Time [s]", value: (u, v) => (v == null ? "–" : v.toFixed(2)) }, ...chart.lines.map(series)],
    hooks: { drawClear: [(u) => drawBelow(u, chart)], draw: [(u) => drawTime(u, clock)] },
  };
  const plot = new uPlot(options, data, holder);
  addBandLegend(holder, chart);
  new ResizeObserver(() => {
    if (holder.clientWidth !== plot.width) plot.setSize({ width: holder.clientWidth, height: HEIGHT_PX });
  }).observe(holder);
  return plot;
}

/** Returns whether limits of the time are those of a chart's own data, not what the reader has chosen. */
function isWhole(plot, low, high) {
  const times = plot.data[0];
  return low == null || times.length < 2 || (low === times[0] && high === times.at(-1));
}

function axis(label, size) {
  return {
    label,
    labelSize: 18,
    size,
    font: FONT,
    labelFont: FONT,
    gap: 4,
    stroke: () => colour("faint"),
    grid: { stroke: () => colour("grid"), width: 1 },
    ticks: { stroke: () => colour("grid"), width: 1 },
    values: (u, values) => values.map((v) => (v == null ? null : short(Number(v.toPrecision(6))))),
  };
}

/** Returns a number that has room beside an axis. */
function short(value) {
  const size = Math.abs(value);
  return size >= 1e5 || (size > 0 && size < 1e-3) ? value.toExponential().replace("e+", "e") : String(value);
}

function series(line) {
  return {
    label: line.label,
    stroke: () => colour(line.colour),
    width: line.width,
    dash: line.dashed ? [6, 4] : undefined,
    paths: line.stepped ? uPlot.paths.stepped({ align: line.stepped === "after" ? 1 : -1 }) : undefined,
    points: {
      show: line.x.length < FEW && !line.dashed && line.stepped === "",
      filter: (u, k, all) => (all ? null : lone(u.data[k])),
      size: 3.5,
      fill: () => colour(line.colour),
    },
    value: (u, v) => (v == null ? "–" : String(Number(v.toPrecision(4)))),
  };
}

/** Returns the rows of values between two gaps (null), to which no line leads; of other lines' times they are undefined. */
function lone(values) {
  const own = [...values.keys()].filter((k) => values[k] !== undefined);
  return own.filter((k, n) => values[k] !== null && values[own[n - 1]] == null && values[own[n + 1]] == null);
}

function addBandLegend(holder, chart) {
  const body = holder.querySelector(".u-legend");
  const rows = chart.bands.map((band) => [band.label, band.colour]);
  if (chart.shades.length) rows.push(["no update", "coasted"]);
  for (const [label, name] of rows) {
    const row = document.createElement("tr");
    row.className = "u-series u-plain";
    const cell = document.createElement("th");
    const marker = document.createElement("div");
    marker.className = "u-marker";
    Object.assign(marker.style, { background: `var(--${name})`, borderColor: `var(--${name})`, opacity: name === "band" || name === "coasted" ? 1 : 0.3 });
    const text = document.createElement("div");
    text.className = "u-label";
    text.textContent = label;
    cell.append(marker, text);
    row.append(cell);
    body.append(row);
  }
}

/** Draws shades, bands and marks below the lines. */
function drawBelow(plot, chart) {
  const { ctx, bbox } = plot;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  const x = (value) => plot.valToPos(value, "x", true);
  ctx.fillStyle = colour("coasted");
  for (const [from, to] of chart.shades) { // whole pixels: no seam between one and the next
    const left = Math.floor(x(from));
    ctx.fillRect(left, bbox.top, Math.ceil(x(to)) - left, bbox.height);
  }
  chart.bands.forEach((band) => drawBand(plot, band, x));
  ctx.strokeStyle = colour("mark");
  ctx.setLineDash([5, 4]);
  for (const mark of chart.marks) line(ctx, x(mark.x), bbox);
  ctx.restore();
}

function drawBand(plot, band, x) {
  const { ctx } = plot;
  const y = (value) => plot.valToPos(value, "y", true);
  const rows = band.x.map((_, k) => k).filter((k) => band.low[k] != null && band.high[k] != null);
  ctx.beginPath();
  rows.forEach((k) => ctx.lineTo(x(band.x[k]), y(band.high[k])));
  [...rows].reverse().forEach((k) => ctx.lineTo(x(band.x[k]), y(band.low[k])));
  ctx.closePath();
  ctx.fillStyle = colour(band.colour);
  ctx.globalAlpha = band.colour === "band" ? 1 : 0.16;
  ctx.fill();
  ctx.globalAlpha = 1;
}

function drawTime(plot, clock) {
  const { ctx, bbox } = plot;
  const at = plot.valToPos(clock.time, "x", true);
  if (at < bbox.left || at > bbox.left + bbox.width) return;
  ctx.save();
  ctx.strokeStyle = colour("accent");
  line(ctx, at, bbox);
  ctx.restore();
}

function line(ctx, at, bbox) {
  ctx.lineWidth = 1;
  ctx.beginPath();
  ctx.moveTo(at, bbox.top);
  ctx.lineTo(at, bbox.top + bbox.height);
  ctx.stroke();
}

/** Returns the limits of the values of each row of charts, over all columns. */
function rowRanges(cells) {
  const rows = Math.max(...cells.map((cell) => cell.charts.length));
  return Array.from({ length: rows }, (_, row) => {
    const shown = cells.map((cell) => cell.charts[row]).filter(Boolean);
    const values = shown.flatMap((chart) => [
      ...chart.lines.flatMap((one) => one.y),
      ...chart.bands.flatMap((band) => [...band.low, ...band.high]),
    ]).filter((value) => value != null);
    return limits(values, shown[0]);
  });
}

function limits(values, { log, zero }) {
  let low = values.reduce((a, b) => Math.min(a, b), Infinity);
  let high = values.reduce((a, b) => Math.max(a, b), -Infinity);
  if (!Number.isFinite(low)) return log ? [0.1, 10] : [0, 1];
  if (log) return [roundedDown(low), roundedUp(high)];
  if (zero) low = Math.min(low, 0);
  const margin = 0.06 * (high - low) || 0.5;
  return [zero && low === 0 ? 0 : low - margin, high + margin];
}

function roundedDown(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return power * ROUND.filter((factor) => factor * power <= value * (1 + 1e-9)).at(-1);
}

function roundedUp(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return power * ROUND.find((factor) => factor * power >= value * (1 - 1e-9));
}

function timeSpan(cells) {
  const times = cells.flatMap((cell) => cell.charts.flatMap((chart) => chart.lines.flatMap((one) => [one.x[0], one.x.at(-1)])));
  return [Math.min(0, ...times), Math.max(...times)];
}

/** Puts a chart into words: each curve with its least and greatest value. */
function describe(figure, cell, chart) {
  const curves = chart.lines.map((one) => {
    const values = one.y.filter((value) => value != null);
    if (!values.length) return `${one.label}: no values`;
    return `${one.label} from ${values.reduce((a, b) => Math.min(a, b))} to ${values.reduce((a, b) => Math.max(a, b))}`;
  });
  return `${figure.title}, ${cell.title}: ${chart.title} over time; ${curves.join("; ")}`;
}
