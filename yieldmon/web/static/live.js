// The live page: one stream of events, values, trend and map that grow with it, and the buttons.

import { BandChart } from "./chart.js";
import { FieldMap } from "./map.js";
import { amount, command, getJson, getPoints, inUnit, make, number, set, time, typedMass, words } from "./ui.js";

const HOUR = 3600;
const RETRY_MS = 3000;
const SAME_SECOND_S = 0.5;
// The server gives a sign of life every two seconds.
const SILENT_MS = 8000;
// Beyond this a correction is more likely a wrong unit or load.
const UNLIKELY_PCT = 30;

const page = await getJson("/api/page");
const at = Object.fromEntries(page.columns.map((name, index) => [name, index]));
const trend = new BandChart(document.getElementById("trend"));
let units = page.units;
const map = new FieldMap(document.getElementById("map"), { tiles: page.tiles, name: "Today's map", unit: units.flow });
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
    const value = row[at.mass_flow_kg_s];
    const known = value !== null && value > 0 && place[at.number] > mapped;
    if (known && Math.abs(place[at.time_s] - now) <= SAME_SECOND_S) map.add(place[at.longitude_deg], place[at.latitude_deg], value);
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

const mass = (kg) => amount(kg, units.mass);
const named = (noun, numbers) =>
  numbers.length > 1 ? `${noun}s ${numbers.slice(0, -1).join(", ")} and ${numbers.at(-1)}` : `${noun} ${numbers[0]}`;
const flow = (kgS, most) => amount(kgS, units.flow, most);

// Names of the units; the curve and the map are drawn anew where they change, with the crop or the daemon's configuration. What is
// being typed into a dialog keeps the units that it was begun in.
function showUnits(begins) {
  if (!begins && (document.querySelector("dialog[open]") || JSON.stringify(state.units) === JSON.stringify(units))) return;
  units = state.units;
  for (const element of document.querySelectorAll("[data-unit]")) {
    if (element.textContent !== units[element.dataset.unit].name) element.textContent = units[element.dataset.unit].name;
  }
  map.setUnit(units.flow);
}

function show() {
  const now = state.now ?? {};
  const harvesting = now.mass_flow_kg_s !== null && now.mass_flow_kg_s !== undefined;
  set("flow", flow(now.mass_flow_kg_s));
  set("flow-band", harvesting ? `± ${flow(now.std_dev_kg_s)} ${units.flow.name}` : words(now.quality ?? ""));
  set("flow-hour", harvesting && units.hourly ? `${amount(now.mass_flow_kg_s, units.hourly)} ${units.hourly.name}` : "");
  const load = state.load;
  const area = load.area_m2 ? `${amount(load.area_m2, units.area)} ${units.area.name}` : "";
  const names = [load.field, load.crop, area].filter(Boolean).join(", ");
  const grain = ["harvesting", "sweeping"].includes(state.state);
  const lost = grain && !load.open;
  set("load-name", `Load ${load.number}${load.open ? "" : " (ended)"}${names ? `: ${names}` : ""}`);
  set("load-note", lost ? "Grain counts only in the total" : "");
  document.getElementById("load-tile").classList.toggle("warning", lost);
  set("load", mass(load.mass_kg));
  set("load-band", load.std_dev_kg === null ? "" : `± ${mass(load.std_dev_kg)}`);
  set("total", amount(state.total.mass_kg, units.total));
  set("yield", amount(now.yield_kg_m2, units.yield));
  set("moisture", number(now.moisture_pct, 1));
  set("speed", amount(now.ground_speed_m_s, units.speed));
  set("elevator", number(now.elevator_speed_rpm));
  set("plate", number(now.plate_angle_deg, 1));
  const sweep = state.sweep;
  const moving = ["moving", "settling", "measuring", "returning"].includes(sweep.state);
  const due = sweep.state !== "waiting" && sweep.due_in_s ? `, next in ${number(sweep.due_in_s / 60)} min` : "";
  set("sweep", words(sweep.state) + (moving ? ` ${number(sweep.progress_pct)} %` : due));
  showFaults();
}

function showFaults() {
  const waits = state.zero_waits_for;
  const text = JSON.stringify([waits, state.zero_mv === null, state.faults.map((fault) => [fault.code, fault.detail])]);
  if (text === shownFaults) return;
  shownFaults = text;
  const lines = state.faults.map((fault) => {
    const line = make("p", "", `fault ${fault.severity}`);
    line.append(make("strong", fault.code + (fault.detail ? ` (${fault.detail})` : "")), ` ${fault.effect} ${fault.remedy}`);
    return line;
  });
  // Stays in view where the lines below have to be scrolled.
  const names = state.faults.map((fault) => fault.code).join(", ");
  if (lines.length > 1) lines.unshift(make("p", `${lines.length} faults: ${names}`, "fault-names"));
  document.getElementById("faults").replaceChildren(...lines);
  if (!waits) return;
  const uncounted = state.zero_mv === null ? " Until then no mass is counted." : "";
  document.getElementById("faults").append(make("p", `The zero waits for ${waits}.${uncounted}`, "fault"));
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
  if (rows.length || begins) showTrend();
  Object.assign(document.body.dataset, seen);
}

function showTrend() {
  const converted = (values) => values.map((value) => inUnit(value, units.flow));
  trend.show(hour.time, converted(hour.flow), converted(hour.deviation));
}

function describe() {
  const known = hour.flow.filter((value) => value !== null);
  if (!known.length) return;
  const [low, high] = known.reduce(([a, b], value) => [Math.min(a, value), Math.max(b, value)], [Infinity, -Infinity]);
  const mean = known.reduce((sum, value) => sum + value, 0) / known.length;
  const text = `Mass flow of the last hour: mean ${flow(mean, 1)}, lowest ${flow(low, 1)}, highest ${flow(high, 1)} ${units.flow.name}`;
  document.getElementById("trend").setAttribute("aria-label", text);
}

// A server that hangs keeps the connection open: what it said last would pass for what is.
let heard = performance.now();
let said = ["", true];

function say(text, bad) {
  said = [text, bad];
  showState(text, bad);
}

function watchSilence() {
  const silent = performance.now() - heard;
  if (silent > SILENT_MS) showState(`no news for ${number(silent / 1000)} s`, true);
}

function alive() {
  const silent = performance.now() - heard > SILENT_MS;
  heard = performance.now();
  if (silent) showState(...said);
}

function live(event) {
  heard = performance.now();
  const news = JSON.parse(event.data);
  if (news.problem) {
    say(news.problem, true);
    return;
  }
  const first = state === null;
  state = news;
  showUnits(first);
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
  const silent = news.bus.frames_per_s === 0 ? ": no frames on the bus" : "";
  say(news.stale ? `stale for ${number(news.age_s)} s` : words(news.state) + silent, news.stale || silent !== "");
  show();
}

function connect() {
  const stream = new EventSource("/api/live");
  stream.addEventListener("live", live);
  stream.addEventListener("alive", alive);
  stream.addEventListener("error", () => {
    showState("no connection", true);
    // The browser tries again by itself, but for answers that are an error.
    if (stream.readyState === EventSource.CLOSED) setTimeout(async () => { await getJson("/api/page").catch(() => null); connect(); }, RETRY_MS);
  });
}

// Buttons

function answerOf(name, answer) {
  if (name === "load-start") {
    const crop = answer.parameters?.changed ? `; measuring with the parameters of ${answer.crop}`
      : answer.crop_known === false ? `; ${answer.crop} is not a known crop: it starts with the parameters of the crop before` : "";
    return `Load ${answer.load} begun${crop}.`;
  }
  if (name === "load-stop") return `Load ${answer.load} ended: ${mass(answer.mass_kg)} ${units.mass.name}.`;
  if (name === "ticket") {
    const change = 100 * (answer.factor - 1);
    const off = 100 * (answer.weighed_mass_kg / (answer.known_mass_kg ?? answer.measured_mass_kg) - 1);
    const asked = answer.question || (Math.abs(off) > UNLIKELY_PCT ? "That is a lot" : "");
    const doubt = asked ? ` ${asked}; if it is a slip, enter the right mass as another ticket.` : "";
    const first = answer.sets_scale_pct == null ? "" : " It is the first and alone sets the scale: weigh a second load.";
    const replaced = answer.replaces?.length ? ` It replaces ${named("ticket", answer.replaces)} (of a load weighed in parts enter the sum).` : "";
    const left = answer.without_ticket?.length ? ` ${named("Load", answer.without_ticket)} ${answer.without_ticket.length > 1 ? "have" : "has"} no ticket any more.` : "";
    const of = answer.waits_for_crop;
    const use = !answer.is_reference ? `no reference for the calibration: ${answer.why_no_reference}`
      : of ? `a reference for ${of}, whose parameters it updates once that is harvested again` : "a reference for the calibration";
    const masses = `Measured ${mass(answer.measured_mass_kg)} ${units.mass.name}, weighed ${mass(answer.weighed_mass_kg)} ${units.mass.name}`;
    const truck = answer.truck ? ` Of the truck, ${mass(answer.truck.truck_kg - answer.weighed_mass_kg)} ${units.mass.name} are of the other combine.` : "";
    return `${masses} (${number(change, 2)} %); ${use}.${truck}${replaced}${left}${first}${doubt}`;
  }
  if (name === "ticket-undo") {
    const back = answer.version === undefined ? "" : `; measuring with the parameters from before it (version ${answer.version})`;
    const again = answer.updated_again?.length ? `; parameters updated again by ${named("ticket", answer.updated_again)}` : "";
    const left = answer.not_updated_again?.length ? `; not by ${named("ticket", answer.not_updated_again.map((row) => row.ticket))}` : "";
    return `Ticket ${answer.ticket} undone${back}${again}${left}.`;
  }
  if (name === "load-correct") {
    const loads = answer.first_load === answer.last_load ? `Load ${answer.first_load}` : `Loads ${answer.first_load} to ${answer.last_load}`;
    const again = answer.measured_again?.length ? "; recomputed" : "";
    const not = answer.not_measured_again?.length ? `; ${named("load", answer.not_measured_again.map((row) => row.load))} ${answer.not_measured_again.length > 1 ? "are" : "is"} not recomputed` : "";
    const next = answer.goes_on ? ` The next load is still ${answer.goes_on}: New load with ${answer.crop} if it is not.` : "";
    return `${loads}: ${[answer.field, answer.crop].filter(Boolean).join(" ")}${again}${not}.${next}`;
  }
  if (name === "zero") return `Zero calibration ${answer.zero}.`;
  if (name === "zero-undo") return `Zero calibration undone; ${mass(answer.restored_kg)} ${units.mass.name} since then.`;
  return `Sweep: ${answer.sweep}.`;
}

function requestOf(dialog) {
  const given = Object.fromEntries(new FormData(dialog.querySelector("form")));
  const request = { command: dialog.dataset.command };
  for (const [name, value] of Object.entries(given)) {
    // A name that was filled in and has been taken out is refused by the daemon; the load would have it all the same.
    const takenOut = request.command === "load-start" && dialog.querySelector(`[name=${name}]`).defaultValue !== "";
    if (String(value).trim() === "" && !takenOut) continue;
    request[name] = ["first_load", "last_load", "ticket"].includes(name) ? Number(value) : String(value).trim();
  }
  for (const name of ["mass", "other", "other_std_dev"]) {
    if (!(name in request)) continue;
    request[`${name}_kg`] = typedMass(request[name], units.mass) * units.mass.si;
    delete request[name];
  }
  if (["load-start", "load-stop"].includes(request.command)) request.shown_load = Number(dialog.dataset.load);
  return request;
}

function open(dialog) {
  dialog.querySelector("form").reset();
  dialog.querySelector(".problem").textContent = "";
  if (state) {
    dialog.dataset.load = state.load.number;
    const text = dialog.querySelector("[data-text=load]");
    if (text) text.textContent = `Load ${state.load.number} has ${mass(state.load.mass_kg)} ${units.mass.name}${state.load.open ? "" : " and is ended"}.`;
    if (dialog.dataset.command === "load-start") {
      for (const name of ["field", "crop"]) dialog.querySelector(`[name=${name}]`).defaultValue = state.load[name];
    }
  }
  if (dialog.dataset.command === "load-correct" && state) {
    const form = dialog.querySelector("form");
    const ended = state.last_complete_load;
    if (ended !== null) form.first_load.value = form.last_load.value = ended;
  }
  if (dialog.dataset.command === "ticket") prepareTicket(dialog);
  if (dialog.dataset.command === "ticket-undo") prepareTicketUndo(dialog);
  dialog.showModal();
}

async function prepareTicket(dialog) {
  const text = dialog.querySelector("[data-text=ticket]");
  const form = dialog.querySelector("form");
  text.textContent = "";
  // Before the store has answered: by then somebody may be typing.
  const ended = state === null ? null : state.last_complete_load;
  if (ended !== null) form.first_load.value = form.last_load.value = ended;
  try {
    const { loads } = await getJson("/api/history");
    const compare = () => {
      const [first, last] = ["first_load", "last_load"].map((name) => Number(form[name].value));
      let weighed;
      try {
        const [whole, other] = [form.mass, form.other].map(({ value }) => (value.trim() ? typedMass(value, units.mass) : 0));
        weighed = (whole - other) * units.mass.si;
      } catch (error) {
        text.textContent = error.message;
        return;
      }
      const covered = loads.filter((load) => first <= load.number && load.number <= last);
      const measured = covered.reduce((sum, load) => sum + load.mass_kg, 0);
      const known = covered.reduce((sum, load) => sum + (load.posted_mass_kg ?? load.mass_kg), 0);
      const change = measured > 0 && weighed > 0 ? 100 * (weighed / measured - 1) : null;
      const doubt = change !== null && Math.abs(100 * (weighed / known - 1)) > UNLIKELY_PCT ? " Is that the right load and unit?" : "";
      const against = change === null ? "" : `, weighed ${mass(weighed)} ${units.mass.name}: ${number(change, 1)} %`;
      text.textContent = `Measured ${mass(measured)} ${units.mass.name}${against}.${doubt}`;
    };
    form.oninput = compare;
    compare();
  } catch (error) {
    text.textContent = error.message;
  }
}

async function prepareTicketUndo(dialog) {
  const text = dialog.querySelector("[data-text=tickets]");
  const select = dialog.querySelector("[name=ticket]");
  const yes = dialog.querySelector(".yes");
  select.replaceChildren();
  yes.disabled = true;
  text.textContent = "";
  try {
    const { tickets } = await getJson("/api/history");
    const standing = tickets.filter((ticket) => ticket.undone_s === null);
    const loads = ({ first_load: first, last_load: last }) => (first === last ? `load ${first}` : `loads ${first} to ${last}`);
    select.replaceChildren(...standing.map((ticket) => {
      const label = `${ticket.number}: ${loads(ticket)}, ${mass(ticket.weighed_mass_kg)} ${units.mass.name}, ${time(ticket.time_s)}`;
      return Object.assign(make("option", label), { value: ticket.number });
    }));
    if (!standing.length) text.textContent = "There is no ticket.";
    yes.disabled = !standing.length;
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
        set("answer-time", time(Date.now() / 1000).slice(-5));
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
setInterval(watchSilence, 1000);
