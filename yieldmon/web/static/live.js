// The live page: one stream of events, values, trend and map that grow with it, and the buttons.

import { BandChart } from "./chart.js";
import { FieldMap } from "./map.js";
import { command, getJson, getPoints, make, number, set, words } from "./ui.js";

const HOUR = 3600;
const RETRY_MS = 3000;
const SAME_SECOND_S = 0.5;
// Beyond this a correction is more likely a wrong unit or load.
const UNLIKELY_PCT = 30;

const page = await getJson("/api/page");
const at = Object.fromEntries(page.columns.map((name, index) => [name, index]));
const trend = new BandChart(document.getElementById("trend"));
const map = new FieldMap(document.getElementById("map"), { tiles: page.tiles, name: "Today's map" });
const hour = { time: [], flow: [], deviation: [] };
const seen = { first: 0, last: 0, missed: 0 };
let state = null;
let shownFaults = "";

// Map: the flow of a second belongs to the ground that was cut flow_delay_s before it.

let mapped = Infinity;
const places = [];

function mapRow(row) {
  const now = row[at.time_s] - page.flow_delay_s;
  if (row[at.latitude_deg] !== null && row[at.longitude_deg] !== null) places.push(row);
  while (places.length && places[0][at.time_s] < now + SAME_SECOND_S) {
    const place = places.shift();
    const flow = row[at.mass_flow_kg_s];
    const known = flow !== null && flow > 0 && place[at.number] > mapped;
    if (known && Math.abs(place[at.time_s] - now) <= SAME_SECOND_S) map.add(place[at.longitude_deg], place[at.latitude_deg], flow);
  }
}

async function loadMap(rows) {
  map.clear();
  places.length = 0;
  mapped = Infinity;
  try {
    const points = await getPoints({ day: "today" });
    map.addAll(points);
    // The newest seconds have places whose flow is still on its way.
    mapped = points.last - Math.ceil(page.flow_delay_s);
  } catch {
    mapped = 0;
  }
  const known = new Set(rows);
  for (const row of [...rows, ...arrived.filter((later) => !known.has(later))]) mapRow(row);
  arrived = null;
  map.show();
}
let arrived = [];

// Values

function show() {
  const now = state.now ?? {};
  const harvesting = now.mass_flow_kg_s !== null && now.mass_flow_kg_s !== undefined;
  set("flow", number(now.mass_flow_kg_s, 2));
  set("flow-band", harvesting ? `± ${number(now.std_dev_kg_s, 2)} kg/s` : words(now.quality ?? ""));
  set("flow-hour", harvesting ? `${number(3.6 * now.mass_flow_kg_s, 1)} t/h` : "");
  const load = state.load;
  const names = [load.field, load.crop].filter(Boolean).join(", ");
  set("load-name", `Load ${load.number}${load.open ? "" : " (ended)"}${names ? `: ${names}` : ""}`);
  set("load", number(load.mass_kg));
  set("load-band", load.std_dev_kg === null ? "" : `± ${number(load.std_dev_kg)}`);
  set("total", number(state.total.mass_kg / 1000, 2));
  set("moisture", number(now.moisture_pct, 1));
  set("speed", number(now.ground_speed_m_s === null || now.ground_speed_m_s === undefined ? null : 3.6 * now.ground_speed_m_s, 1));
  set("elevator", number(now.elevator_speed_rpm));
  set("plate", number(now.plate_angle_deg, 1));
  const sweep = state.sweep;
  const moving = ["moving", "settling", "measuring", "returning"].includes(sweep.state);
  const due = sweep.due_in_s ? `, next in ${number(sweep.due_in_s / 60)} min` : "";
  set("sweep", words(sweep.state) + (moving ? ` ${number(sweep.progress_pct)} %` : due));
  showFaults();
}

function showFaults() {
  const text = JSON.stringify(state.faults.map((fault) => [fault.code, fault.detail]));
  if (text === shownFaults) return;
  shownFaults = text;
  document.getElementById("faults").replaceChildren(...state.faults.map((fault) => {
    const line = make("p", "", `fault ${fault.severity}`);
    line.append(make("strong", fault.code + (fault.detail ? ` (${fault.detail})` : "")), ` ${fault.effect} ${fault.remedy}`);
    return line;
  }));
}

function showState(text, bad) {
  set("state", text);
  document.getElementById("state").classList.toggle("bad", bad);
  document.body.classList.toggle("stale", bad);
}

// Seconds

function take(rows, begins) {
  if (begins) {
    for (const list of Object.values(hour)) list.length = 0;
    seen.last = 0;
  }
  for (const row of rows) {
    if (seen.last && row[at.number] > seen.last + 1) seen.missed += row[at.number] - seen.last - 1;
    if (!seen.first) seen.first = row[at.number];
    seen.last = row[at.number];
    hour.time.push(row[at.time_s]);
    hour.flow.push(row[at.mass_flow_kg_s]);
    hour.deviation.push(row[at.std_dev_kg_s]);
  }
  const surplus = hour.time.length - HOUR;
  if (surplus > 0) for (const list of Object.values(hour)) list.splice(0, surplus);
  if (rows.length || begins) trend.show(hour.time, hour.flow, hour.deviation);
  Object.assign(document.body.dataset, seen);
}

function describe() {
  const known = hour.flow.filter((flow) => flow !== null);
  if (!known.length) return;
  const [low, high] = known.reduce(([a, b], flow) => [Math.min(a, flow), Math.max(b, flow)], [Infinity, -Infinity]);
  const mean = known.reduce((sum, flow) => sum + flow, 0) / known.length;
  const text = `Mass flow of the last hour: mean ${number(mean, 1)}, lowest ${number(low, 1)}, highest ${number(high, 1)} kg/s`;
  document.getElementById("trend").setAttribute("aria-label", text);
}

function live(event) {
  const news = JSON.parse(event.data);
  if (news.problem) {
    showState(news.problem, true);
    return;
  }
  const first = state === null;
  state = news;
  take(news.rows, news.begins);
  if (first || news.begins) {
    arrived = [];
    loadMap(news.rows).then(describe);
  } else if (arrived) {
    arrived.push(...news.rows);
  } else if (news.rows.length) {
    news.rows.forEach(mapRow);
    map.show();
  }
  showState(news.stale ? `stale for ${number(news.age_s)} s` : words(news.state), news.stale);
  show();
}

function connect() {
  const stream = new EventSource("/api/live");
  stream.addEventListener("live", live);
  stream.addEventListener("error", () => {
    showState("no connection", true);
    // The browser tries again by itself, but for answers that are an error.
    if (stream.readyState === EventSource.CLOSED) setTimeout(async () => { await getJson("/api/page").catch(() => null); connect(); }, RETRY_MS);
  });
}

// Buttons

function answerOf(name, answer) {
  if (name === "load-start") {
    const crop = answer.parameters?.changed ? `; measuring with the parameters of ${answer.crop}` : "";
    return `Load ${answer.load} begun${crop}.`;
  }
  if (name === "load-stop") return `Load ${answer.load} ended: ${number(answer.mass_kg)} kg.`;
  if (name === "ticket") {
    const change = 100 * (answer.factor - 1);
    const doubt = Math.abs(change) > UNLIKELY_PCT ? " That is a lot; if it is a slip, enter the right mass as another ticket." : "";
    const use = answer.anchor ? "a reference for the calibration" : "no reference for the calibration";
    return `Measured ${number(answer.measured_mass_kg)} kg, weighed ${number(answer.weighed_mass_kg)} kg (${number(change, 2)} %); ${use}.${doubt}`;
  }
  if (name === "zero") return `Zero calibration ${answer.zero}.`;
  if (name === "zero-undo") return `Zero calibration undone; ${number(answer.restored_kg, 1)} kg since then.`;
  return `Sweep: ${answer.sweep}.`;
}

function requestOf(dialog) {
  const given = Object.fromEntries(new FormData(dialog.querySelector("form")));
  const request = { command: dialog.dataset.command };
  for (const [name, value] of Object.entries(given)) {
    if (String(value).trim() === "") continue;
    request[name] = ["first_load", "last_load", "mass_kg"].includes(name) ? Number(value) : String(value).trim();
  }
  if (request.command.startsWith("load-")) request.shown_load = Number(dialog.dataset.load);
  return request;
}

function open(dialog) {
  dialog.querySelector("form").reset();
  dialog.querySelector(".problem").textContent = "";
  if (state) {
    dialog.dataset.load = state.load.number;
    const text = dialog.querySelector("[data-text=load]");
    if (text) text.textContent = `Load ${state.load.number} has ${number(state.load.mass_kg)} kg${state.load.open ? "" : " and is ended"}.`;
    if (dialog.dataset.command === "load-start") {
      dialog.querySelector("[name=field]").value = state.load.field;
      dialog.querySelector("[name=crop]").value = state.load.crop;
    }
  }
  if (dialog.dataset.command === "ticket") prepareTicket(dialog);
  dialog.showModal();
}

async function prepareTicket(dialog) {
  const text = dialog.querySelector("[data-text=ticket]");
  const form = dialog.querySelector("form");
  text.textContent = "";
  try {
    const { loads } = await getJson("/api/history");
    const ended = loads.filter((load) => load.ended_s !== null || load.number !== state?.load.number || !state.load.open);
    if (ended.length && !form.first_load.value) form.first_load.value = form.last_load.value = ended[0].number;
    const compare = () => {
      const [first, last, mass] = ["first_load", "last_load", "mass_kg"].map((name) => Number(form[name].value));
      const measured = loads.filter((load) => first <= load.number && load.number <= last).reduce((sum, load) => sum + load.mass_kg, 0);
      const change = measured > 0 && mass > 0 ? 100 * (mass / measured - 1) : null;
      const doubt = change !== null && Math.abs(change) > UNLIKELY_PCT ? " Is that the right load and unit?" : "";
      text.textContent = `Measured ${number(measured)} kg${change === null ? "" : `: ${number(change, 1)} %`}.${doubt}`;
    };
    form.oninput = compare;
    compare();
  } catch (error) {
    text.textContent = error.message;
  }
}

function prepareButtons() {
  document.getElementById("buttons").hidden = page.read_only;
  if (page.read_only) return;
  for (const button of document.querySelectorAll("[data-dialog]")) {
    const dialog = document.getElementById(button.dataset.dialog);
    button.addEventListener("click", () => open(dialog));
    dialog.querySelector(".no").addEventListener("click", () => dialog.close());
    dialog.querySelector("form").addEventListener("submit", async (event) => {
      event.preventDefault();
      const yes = dialog.querySelector(".yes");
      yes.disabled = true;
      try {
        const answer = await command(requestOf(dialog));
        set("answer", answerOf(dialog.dataset.command, answer));
        dialog.close();
      } catch (error) {
        dialog.querySelector(".problem").textContent = error.message;
      } finally {
        yes.disabled = false;
      }
    });
  }
  getJson("/api/history").then(({ loads }) => {
    for (const name of ["field", "crop"]) {
      const values = [...new Set(loads.map((load) => load[name]).filter(Boolean))];
      document.getElementById(`known-${name}s`).replaceChildren(...values.map((value) => Object.assign(make("option"), { value })));
    }
  }).catch(() => null);
}

prepareButtons();
connect();
setInterval(describe, 60_000);
