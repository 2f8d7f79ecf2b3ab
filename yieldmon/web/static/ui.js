// What both pages share: asking, numbers, tables. Text from the store or the daemon goes in as text, never as markup.

// What the browser calls "Failed to fetch", or "Load failed".
async function reach(path, options, said = "No connection to the monitor.") {
  try {
    return await fetch(path, options);
  } catch {
    throw new Error(said);
  }
}

export async function getJson(path) {
  const answer = await reach(path);
  if (answer.status === 401) location.assign("/sign-in");
  const document = await answer.json();
  if (!answer.ok) throw new Error(document.error ?? `status ${answer.status}`);
  return document;
}

export async function getPoints(query) {
  const answer = await reach(`/api/points?${new URLSearchParams(query)}`);
  if (!answer.ok) throw new Error((await answer.json()).error ?? `status ${answer.status}`);
  const buffer = await answer.arrayBuffer();
  const [count, last] = new Uint32Array(buffer, 0, 2);
  return {
    last,
    longitude: new Int32Array(buffer, 8, count),
    latitude: new Int32Array(buffer, 8 + 4 * count, count),
    flow: new Float32Array(buffer, 8 + 8 * count, count),
  };
}

export async function command(request) {
  const options = { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(request) };
  const lost = "No connection to the monitor: whether this arrived is not known. See History before you send it again.";
  const answer = await reach("/api/command", options, lost);
  const document = await answer.json();
  if (!answer.ok) throw new Error(document.error ?? `status ${answer.status}`);
  return document;
}

export function number(value, decimals = 0) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "-";
  return value.toLocaleString("en", { minimumFractionDigits: decimals, maximumFractionDigits: decimals });
}

// A value in SI in a unit of the page, null where it is not known.
export const inUnit = (value, unit) => (value === null || value === undefined || !unit ? null : value / unit.si);

// An SI value in a unit, with the unit's own decimals or fewer.
export const amount = (value, unit, most = Infinity) => number(inUnit(value, unit), Math.min(unit.decimals, most));

// A value and its standard deviation to two digits that count; a value that is exact by itself.
export function withDeviation({ value, std_dev: deviation }) {
  if (!deviation || !Number.isFinite(deviation)) return Number.isFinite(value) ? String(Number(value.toPrecision(4))) : "-";
  const decimals = Math.min(6, Math.max(0, 1 - Math.floor(Math.log10(deviation))));
  return `${number(value, decimals)} ± ${number(deviation, decimals)}`;
}

// Numbers with marks between thousands: 41,222 as the page shows them, 41.222,5 and 41 222,5 as others write them.
const IN_THOUSANDS = [
  [/^[1-9]\d{0,2}(,\d{3})+(\.\d+)?$/, /,/g],
  [/^[1-9]\d{0,2}(\.\d{3})+(,\d+)?$/, /\./g],
  [/^[1-9]\d{0,2}([\s'’]\d{3})+([.,]\d+)?$/, /[\s'’]/g],
];
const EITHER = /^[1-9]\d{0,2}\.\d{3}$/;

// A mass as people type it, in a unit of the page. The browser's own kind of input for numbers drops commas: 190,5 is 1905 there.
export function typedMass(text, unit) {
  const typed = text.trim();
  if (EITHER.test(typed)) throw new Error(`${typed} can be ${typed.replace(".", "")} or ${Number(typed)} ${unit.name}: enter it without the point.`);
  const marks = IN_THOUSANDS.find(([form]) => form.test(typed))?.[1] ?? "";
  const plain = typed.replace(marks, "").replace(",", ".");
  if (!/^\d+(\.\d+)?$/.test(plain)) throw new Error(`"${typed}" is not a number of ${unit.name}, such as 9120 or 9120.5.`);
  return Number(plain);
}

export function set(id, text) {
  const element = document.getElementById(id);
  if (element.textContent !== text) element.textContent = text;
}

export function make(tag, text = "", className = "") {
  const element = document.createElement(tag);
  if (text !== "") element.textContent = text;
  if (className) element.className = className;
  return element;
}

export function time(seconds) {
  return seconds === null ? "-" : new Date(1000 * seconds).toLocaleString("sv").slice(0, 16);
}

// From so many letters on a column is wide enough to read, on a phone beyond its edge.
const LONG = 30;
const MOMENT = /^\d{4}-\d\d-\d\d \d\d:\d\d$/;

export function table(element, columns, rows) {
  const head = make("tr");
  for (const [title] of columns) head.append(Object.assign(make("th", title), { scope: "col" }));
  const body = rows.map((row) => {
    const line = make("tr");
    for (const [, cell, isNumber] of columns) {
      const text = String(cell(row));
      line.append(make("td", text, isNumber ? "number" : MOMENT.test(text) ? "moment" : text.length >= LONG ? "long" : ""));
    }
    return line;
  });
  if (!rows.length) {
    const none = make("td", "none yet");
    none.colSpan = columns.length;
    const line = make("tr");
    line.append(none);
    body.push(line);
  }
  const [top, rest] = [make("thead"), make("tbody")];
  top.append(head);
  rest.append(...body);
  element.replaceChildren(top, rest);
}

export const words = (code) => String(code).replaceAll("_", " ");
