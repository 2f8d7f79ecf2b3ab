// The history page: what the store says.

import { BandChart } from "./chart.js";
import { FieldMap } from "./map.js";
import { amount, getJson, getPoints, inUnit, make, number, set, table, time, withDeviation, words } from "./ui.js";

// Asked for together; what the map shows is in the page's address (?map=all, day 2025-10-09, load 3), else the newest day.
const wanted = new URLSearchParams(location.search).get("map") ?? "";
const query = (choice) => {
  const [kind, value] = choice.split(" ");
  return kind === "all" ? {} : { [kind]: value };
};
const early = getPoints(query(wanted || "day today"));
early.catch(() => {});
const asked = getJson("/api/history");
asked.catch(() => {});
const page = await getJson("/api/page");
const { units } = page;
for (const element of document.querySelectorAll("[data-unit]")) element.textContent = units[element.dataset.unit].name;
const mass = (kg) => amount(kg, units.mass);
const total = (kg) => amount(kg, units.total);
const flow = (kgS, most) => amount(kgS, units.flow, most);
const map = new FieldMap(document.getElementById("map"), { tiles: page.tiles, name: "Map", unit: units.flow });

function days(rows) {
  table(document.getElementById("days-table"), [
    ["Day", (day) => day.day], [`Grain, ${units.total.name}`, (day) => total(day.mass_kg), true],
    ["Harvesting, h", (day) => number(day.harvesting_s / 3600, 2), true], [`Mean flow, ${units.flow.name}`, (day) => flow(day.mean_flow_kg_s), true],
    ["Moisture, %", (day) => number(day.moisture_pct, 1), true], ["Positions", (day) => number(day.points), true],
  ], rows);
}

function loads(rows) {
  table(document.getElementById("loads-table"), [
    ["Load", (load) => load.number, true], ["Field", (load) => load.field || "-"], ["Crop", (load) => load.crop || "-"],
    ["Begun", (load) => time(load.started_s)], ["Ended", (load) => time(load.ended_s)],
    [`Measured, ${units.mass.name}`, (load) => mass(load.mass_kg), true], [`± ${units.mass.name}`, (load) => mass(load.std_dev_kg), true],
    [`Dry, ${units.mass.name}`, (load) => mass(load.dry_mass_kg), true],
    [`Corrected, ${units.mass.name}`, (load) => (load.ticket_id === null && load.posted_mass_kg === null ? "-" : mass(load.corrected_mass_kg)), true],
    [`± ${units.mass.name}`, (load) => (load.ticket_id === null && load.posted_mass_kg === null ? "-" : mass(load.corrected_std_dev_kg)), true],
  ], rows);
}

function tickets(rows) {
  table(document.getElementById("tickets-table"), [
    ["Ticket", (ticket) => ticket.number, true], ["Time", (ticket) => time(ticket.time_s)],
    ["Loads", (ticket) => (ticket.first_load === ticket.last_load ? ticket.first_load : `${ticket.first_load} to ${ticket.last_load}`), true],
    [`Weighed, ${units.mass.name}`, (ticket) => mass(ticket.weighed_mass_kg), true],
    [`Truck − other combine, ${units.mass.name}`, (ticket) => (ticket.truck ? `${mass(ticket.truck.truck_kg)} − ${mass(ticket.truck.other_kg)}` : "-"), true],
    [`Measured, ${units.mass.name}`, (ticket) => mass(ticket.measured_mass_kg), true],
    ["Difference, %", (ticket) => number(100 * (ticket.weighed_mass_kg / ticket.measured_mass_kg - 1), 2), true],
    ["State", (ticket) => ticket.state],
    ["Entered by", (ticket) => ticket.who || "-"], ["Note", (ticket) => ticket.note || "-"],
    ["Undone", (ticket) => (ticket.undone_s === null ? "-" : `${time(ticket.undone_s)} ${ticket.undone_by}`.trim())],
  ], rows);
}

function parameters(versions) {
  const names = [...new Set(versions.flatMap((version) => Object.keys(version.values)))];
  const box = document.getElementById("parameter-charts");
  box.replaceChildren();
  for (const name of names) {
    const known = versions.filter((version) => name in version.values);
    // What is exact and never changes is in the table alone.
    if (known.every((version) => !version.values[name].std_dev && version.values[name].value === known[0].values[name].value)) continue;
    const last = withDeviation(known.at(-1).values[name]);
    const figure = make("figure");
    const chart = make("div");
    chart.setAttribute("role", "img");
    chart.setAttribute("aria-label", `${words(name)} by version, now ${last}`);
    figure.append(make("figcaption", `${words(name)}: ${last}`), chart);
    box.append(figure);
    const values = known.map((version) => version.values[name]);
    new BandChart(chart, { height: 200, points: true }).show(
      known.map((version) => version.time_s), values.map((entry) => entry.value), values.map((entry) => entry.std_dev));
  }
  table(document.getElementById("parameters-table"), [
    ["Version", (version) => version.version, true], ["In use from", (version) => time(version.time_s)],
    ["From", (version) => version.origin], ["Crop", (version) => version.crop ?? "-"],
    ...names.map((name) => [words(name), (version) => {
      const entry = version.values[name];
      return entry ? withDeviation(entry) : "-";
    }, true]),
  ], versions.toReversed());
}

function sweeps(rows) {
  table(document.getElementById("sweeps-table"), [
    ["Time", (sweep) => time(sweep.time_s)], ["Outcome", (sweep) => words(sweep.outcome)], ["Reason", (sweep) => sweep.reason],
    ["Angles, °", (sweep) => (sweep.document.angles_deg ?? []).map((angle) => number(angle)).join(" ")],
    ["Parameters", (sweep) => sweep.document.parameter_version ?? "-", true],
  ], rows);
}

async function residuals() {
  const element = document.getElementById("residuals-table");
  try {
    const found = await getJson("/api/residuals");
    set("residuals-text", found.note ?? `${found.sweeps} sweeps, parameters version ${found.parameter_version}, machine ${found.machine}`);
    const angles = [...new Set(found.cells.map((cell) => cell.plate_angle_deg))];
    const flows = [...new Set(found.cells.map((cell) => cell.mass_flow_kg_s))].sort((a, b) => a - b);
    const at = new Map(found.cells.map((cell) => [`${cell.plate_angle_deg} ${cell.mass_flow_kg_s}`, cell]));
    table(element, [
      ["Plate, °", (angle) => number(angle, 1), true],
      ...flows.map((kgS) => [`${flow(kgS, 1)} ${units.flow.name}`, (angle) => {
        const cell = at.get(`${angle} ${kgS}`);
        return cell ? `${cell.residual_pct > 0 ? "+" : ""}${number(cell.residual_pct, 1)} ± ${number(cell.std_dev_pct, 1)}` : "";
      }, true]),
    ], angles);
  } catch (error) {
    set("residuals-text", error.message);
    element.replaceChildren();
  }
}

function faults(rows) {
  table(document.getElementById("faults-table"), [
    ["Time", (fault) => time(fault.time_s)], ["Fault", (fault) => fault.code], ["", (fault) => (fault.active ? "came" : "went")],
    ["Detail", (fault) => fault.detail || "-"],
  ], rows);
}

let shown = null;

async function showMap(coming) {
  if (shown === coming) return;
  shown = coming;
  try {
    const points = await coming;
    if (shown !== coming) return;
    map.clear();
    map.addAll(points);
    set("state", `${number(map.points)} points`);
  } catch (error) {
    set("state", error.message);
  }
}

function mapChoices(found) {
  const select = document.getElementById("map-of");
  const option = (text, value) => Object.assign(make("option", text), { value });
  select.replaceChildren(
    ...found.days.filter((day) => day.points).map((day) => option(day.day, `day ${day.day}`)),
    option("all days", "all"),
    ...found.loads.map((load) => option(`load ${load.number}${load.field ? `, ${load.field}` : ""}`, `load ${load.number}`)),
  );
  const isThere = [...select.options].some((choice) => choice.value === wanted);
  if (isThere) select.value = wanted;
  select.addEventListener("change", () => {
    history.replaceState(null, "", `?${new URLSearchParams({ map: select.value })}${location.hash}`);
    showMap(getPoints(query(select.value)));
  });
  const isEarly = isThere || (!wanted && select.value === `day ${found.days[0]?.day}`);
  showMap(isEarly ? early : getPoints(query(select.value)));
}

showMap(early);
try {
  const found = await asked;
  mapChoices(found);
  days(found.days);
  loads(found.loads);
  const empty = found.empty_loads.length;
  if (empty) set("loads-empty", `${empty} empty ${empty > 1 ? "loads" : "load"} not listed.`);
  tickets(found.tickets);
  parameters(found.parameters);
  sweeps(found.sweeps);
  faults(found.faults);
  await residuals();
} catch (error) {
  set("state", error.message);
  document.getElementById("state").classList.add("bad");
}
