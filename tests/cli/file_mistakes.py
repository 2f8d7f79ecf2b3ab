"""Mistakes with files: swapped, half filled, titled, of another unit, or where something of one's own would be replaced."""

from __future__ import annotations

import gzip

from yieldmon.resources import shipped

HEAD = "plate_angle_deg,mass_flow_kg_s,force_n\n"
ANSWERS = """\
machine_name: old
bus_interface: virtual
bus_channel: can7
sprocket_pitch_radius_m: 0.0541
paddle_spacings_m: [0.1656, 0.2071]
paddle_length_m: 0.16
paddle_width_m: 0.21
plate_pivot_x_m: 0.4
plate_pivot_above_m: 0.16
plate_length_m: 0.1887
"""
REST = """\
home_plate_angle_deg: 70
min_plate_angle_deg: 40
max_plate_angle_deg: 90
nominal_elevator_speed_rpm: 400
min_elevator_speed_rpm: 250
max_elevator_speed_rpm: 599
largest_flow_kg_s: 25
cell_full_scale_mv: 4000
cell_weights_kg: [0, 5, 10]
cell_readings_mv: [500, 597.6, 695.1]
plate_measured_deg: [46.5, 86.4]
plate_reported_deg: [45, 85]
crop: wheat
"""
WHOLE = ANSWERS + REST
FILES: dict[str, str | bytes] = {
    "machine.yaml": shipped("config/machines/sprocket-8.yaml").read_text(encoding="utf-8"),
    "lb.csv": "plate_angle_deg,mass_flow_lb_s,force_n\n70,5,20\n60,8,18\n",
    "share.csv": "plate_angle_deg,mass_flow_kg_s,force_n,moisture_pct\n70,5,20,0.15\n60,5,18,0.16\n",
    "no-header.csv": "70,5,20\n60,5,18\n45,5,17\n",
    "points-and-commas.csv": "plate_angle_deg;mass_flow_kg_s;force_n\n70;1.234,5;20\n",
    "utf16.csv": HEAD.encode("utf-16"),
    "latin.csv": "load,weighed_kg,note\n1,1000,Schüttgut\n".encode("latin-1"),
    "latin.yaml": "machine_file: Mähdrescher.yaml\n".encode("latin-1"),
    "zip.csv": b"PK\x03\x04 no workbook",
    "plain.log.gz": b"(1.0) can0 123#00\n",
    "torn.log.gz": gzip.compress(b"(1.0) can0 123#00\n" * 500, mtime=0)[:60],
    "logs.zip": b"PK\x03\x04",
    "can.csv": "timestamp,arbitration_id,extended,remote,error,dlc,data\n1.0,0x18ff0117,1,0,0,8,gD4A/////w==\n",
    "empty.log": "",
    "copy.log": "(1.0) can0 123#00\n",
    "empty.sqlite": "",
    "text.sqlite": "rain\n",
    "old.parquet": b"mine",
    "p.sweep.yaml": "mine\n",
    "tables/log.csv": "mine\n",
    "page/index.html": "mine\n",
    "card/TASKDATA/TASKDATA.XML": "the terminal's\n",
    "fits/wet-20.yaml": "mine\n",
    "wet.csv": "plate_angle_deg,mass_flow_kg_s,force_n,moisture_pct\n70,5,45,20\n70,9,80,20\n60,5,40,20\n60,9,70,20\n",
    "field/points.csv": "lon,lat,yield\n8.1,50.1,5\n",
    "half.yaml": ANSWERS,
    "null.yaml": WHOLE.replace("paddle_width_m: 0.21", "paddle_width_m:"),
    "inches.yaml": WHOLE.replace("paddle_length_m: 0.16", "paddle_length_m: 6.3"),
    "pounds.yaml": WHOLE.replace("[0, 5, 10]", "[0, 11.02, 22.05]"),
    "swapped.yaml": WHOLE.replace("[45, 85]", "[85, 45]"),
    "one-reading.yaml": WHOLE.replace("[500, 597.6, 695.1]", "597.6"),
    "words.yaml": WHOLE.replace("[500, 597.6, 695.1]", "500, 597.6 and 695"),
    "whole.yaml": WHOLE,
    "record.yaml": "date: 2026-11-23T08:00:00Z\nanswers:\n  crop: corn\n",
    "blue/setup-answers.yaml": "machine_name: blue\n" + REST,
    "there/yieldmon.yaml": "bus: {channel: can1}\n",
    "dated.csv": "load,weighed_kg\n2026-09-07,1000\n",
    "thousand.csv": 'load,weighed_kg\n1,"9,120"\n',
    "with-unit.csv": "load,weighed_kg\n1,9120kg\n",
    "two-units.csv": "load,weighed_kg,weighed_t\n1,1000,1\n",
    "pipes.csv": "load|weighed_kg\n1|1000\n",
    "no-load.csv": "load,weighed_kg\n,1000\n",
    "title.csv": "Tickets 2026\nload,weighed_kg\n1,1000\n",
    "title-in-cells.csv": "Tickets 2026,,\nload,weighed_kg,note\n1,1000,x\n",
    "tonnes.csv": "load,weighed_kg\n1,1.21\n",
    "quote.csv": 'load,weighed_kg\n"1,1000\n',
    "short.csv": "load,weighed_kg,note\n1,1000\n",
    "gone.csv": "machine,day,log\nold,2026-09-01,gone.log\n",
    "twice-manifest.csv": "machine,day,log\nold,2026-09-01,log.log\nold,2026-09-02,log.log\n",
    "slash.csv": "machine,day,log\na/b,2026-09-01,log.log\n",
    "machine-is-grain.yaml": "machine_file: p.yaml\n",
    "grain-is-machine.yaml": "parameter_file: machine.yaml\n",
    "grain-is-folder.yaml": "parameter_file: folder\n",
    "shape-is-grain.yaml": "pulse_shape_file: p.yaml\n",
    "map-is-grain.yaml": "moisture_map_file: p.yaml\n",
    "curve-is-grain.yaml": "estimator_file: p.yaml\n",
    "yes.yaml": "sweep: {enabled: yes}\n",
    "comma.yaml": "gate:\n  grain_on_n: 1,5\n",
    "imperial.yaml": "units: imperial\n",
    "one-angle.yaml": "sweep: {angles_deg: 40}\n",
}
LOST = {
    "process can.csv --separate --out . --format csv": "--out can.csv: is also an input file; expected another name",
    "process can.csv --separate --out . --format csv --force": "--out can.csv: is also an input file",
    "process log.log --separate --out tables": "--out tables/log.csv: exists already; expected another name, or --force",
    "pack empty.log --out old.parquet --force": "empty.log: no frame at all; expected a log with CAN frames",
    "pack log.log ./log.log --out new.parquet": "./log.log: is named twice, which would double its mass; expected each log once",
    "pack log.log copy.log --out new.parquet": "copy.log: is the same log as log.log and would double its mass",
    "simulate --scenario scenario.yaml --log n.csv --truth n.csv": "--truth n.csv: is also the file of --log; expected another",
    "simulate --scenario scenario.yaml --log n.log --truth ./n.log --force": "--truth ./n.log: is also the file of --log",
    "calibrate table.csv --out n.png --profiles n.png": "--profiles n.png: is also the file of --out; expected another name",
    "diagnose table.csv --adopt diary.txt": "--adopt diary.txt: exists already; expected another name, or --force to replace",
    "diagnose table.csv --adopt table.csv --force": "--adopt table.csv: is also an input file; expected another name",
    "diagnose table.csv --plan p.csv": "--plan p.sweep.yaml: exists already; expected another name, or --force to replace it",
    "diagnose table.csv --report page": "--report page/index.html: exists already; expected another name, or --force to replace it",
    "calibrate wet.csv --by-moisture --out fits": "--out fits/wet-20.yaml: exists already; expected another name, or --force",
    "export table.csv --format taskdata --out card --swath 9": "--out card/TASKDATA/TASKDATA.XML: exists already; expected another",
    "map field/points.csv --out field": "has files that would replace those of",
    "map field --out field": "has files that would replace those of",
    "map field/points.csv ./field/points.csv --out new": "is named twice, which would double its mass; expected each harvest once",
    "setup --out blue --answers half.yaml": "half.yaml: machine_name: is old, but blue/setup-answers.yaml has answers of blue; expected",
    "setup --out there --answers whole.yaml": "there/yieldmon.yaml: exists already; expected another folder for --out, or --force",
    "setup --out diary.txt --answers whole.yaml": "diary.txt is not a folder; expected a folder, or a name that does not exist yet",
    "setup --out diary.txt/new --answers whole.yaml": "diary.txt is not a folder; expected a folder, or a name that does not exist",
    "plot curves --out there/yieldmon.yaml": "--out there/yieldmon.yaml: exists already; expected another name, or --force",
    "totals archive text.sqlite --store text.sqlite": "text.sqlite: exists already; expected a new file",
    "fleet report folder --html diary.txt": "--html diary.txt: exists already; expected another name, or --force to replace it",
    "fleet prior folder --crop corn --out diary.txt": "--out diary.txt: exists already; expected another name, or --force to replace",
    "signals log.log --write diary.txt": "--write diary.txt: exists already; expected another name, or --force to replace it",
    "calibrate --loads log.log --tickets tickets.csv --out tickets.csv --force": "--out tickets.csv: is also an input file",
}
MISTAKES = LOST | {
    # of another kind, or swapped
    "calibrate lb.csv": "lb.csv: header: has no load column; expected one of mass_flow_kg_s, paddle_mass_kg",
    "calibrate share.csv": "share.csv: moisture_pct: has nothing above 0.16; expected per cent; these look like shares",
    "predict --mass-flow 5 --moisture 0.15": "--moisture: is 0.15; expected per cent; this looks like a fraction: 15 %",
    "predict --mass-flow 10t/h": "--mass-flow: is '10t/h'; expected a finite number",
    "predict --mass-flow 5 --params machine.yaml": "machine.yaml: name: unknown key; expected one of friction,",
    "predict --mass-flow 5 --set friction=0.2 --set friction=0.3": "--set: names friction twice; expected each parameter once",
    "calibrate table.csv --prior machine.yaml": "machine.yaml: name: unknown key; expected one of friction,",
    "calibrate table.csv --fix friction=0.2 --fix friction=0.3": "--fix: names friction twice; expected each parameter once",
    "calibrate table.csv --free friction,friction": "--free: names friction twice; expected each parameter once",
    "calibrate table.csv --fix friction=0,2": "--fix friction: is '0,2'; expected a finite number",
    "calibrate table.csv --seed -1": "--seed: is -1; expected a whole number from 0",
    "calibrate table.csv --plate-angle 1.22": "--plate-angle: is 1.22; expected an angle that table.csv holds",
    "diagnose table.csv --seed -1": "--seed: is -1; expected a whole number from 0",
    "demo --seed -1": "--seed: is -1; expected a whole number from 0",
    "simulate --seed -1 --scenario scenario.yaml --log n.log": "--seed: is -1; expected a whole number from 0",
    "simulate --scenario scenario.yaml --log n.log -i virtual -c x": "--log and -i: both given; expected a log or a bus",
    "calibrate tickets.csv": "tickets.csv: header: has no plate_angle_deg; expected that column",
    "calibrate p.yaml": "p.yaml: header: has no plate_angle_deg; expected that column",
    "estimate tickets.csv": "tickets.csv: header: has no plate_angle_deg; expected that column",
    "calibrate no-header.csv": "no-header.csv: header: has no plate_angle_deg; expected that column",
    "calibrate points-and-commas.csv": "points-and-commas.csv: line 2, mass_flow_kg_s: is '1.234,5'; expected a number in kg/s",
    "calibrate utf16.csv": "utf16.csv: is UTF-16 text; expected a UTF-8 CSV file",
    "calibrate zip.csv": "zip.csv: is a zip archive and no Excel workbook; expected a CSV file or a workbook (*.xlsx)",
    "check-config latin.yaml": "latin.yaml: byte 15 is not UTF-8; expected a YAML file in UTF-8",
    "check-config scenario.yaml": "scenario.yaml: duration_s: unknown key; expected one of machine_file,",
    "check-config log.log": "log.log: '(1.0) can0 123#00'; expected lines of key: value",
    "check-config machine-is-grain.yaml": "p.yaml: friction: unknown key; expected one of home_plate_angle_deg,",
    "check-config grain-is-machine.yaml": "machine.yaml: name: unknown key; expected one of friction,",
    "check-config grain-is-folder.yaml": "folder: Is a directory; expected a YAML file, named from ",
    "check-config shape-is-grain.yaml": "p.yaml: friction: unknown key; expected one of source,",
    "check-config map-is-grain.yaml": "p.yaml: friction: unknown key; expected one of moisture_pct,",
    "check-config curve-is-grain.yaml": "p.yaml: is a parameter file; expected a curve that `calibrate --estimator` has",
    "check-config yes.yaml": "yes.yaml: sweep.enabled: 'yes'; expected true or false",
    "check-config comma.yaml": "comma.yaml: gate.grain_on_n: '1,5'; expected a number from 0.01 to 1000 N",
    "check-config imperial.yaml": "imperial.yaml: units: 'imperial'; expected one of metric, us",
    "check-config one-angle.yaml": "one-angle.yaml: sweep.angles_deg: 40; expected a list of numbers, deg",
    "simulate --scenario p.yaml --log n.log": "p.yaml: friction: is not a key of a scenario; expected a key of this section",
    "simulate --scenario table.csv --log n.log": "table.csv: is not a mapping of keys; expected keys such as duration_s",
    "export log.log --out n.csv": "log.log: unknown kind of record '.log'; expected a name that ends in one of .sqlite,",
    "export empty.sqlite --out n.csv": "empty.sqlite: is empty; expected a store of this version or an older one",
    "export text.sqlite --out n.csv": "text.sqlite: file is not a database; expected a daemon's store",
    "plot flow empty.sqlite --out n.png": "empty.sqlite: is empty; expected a store of this version or an older one",
    "plot published p.yaml --out n.png": "p.yaml: lacks 'generated_momentum'; expected the published tables",
    # no log
    "process table.csv --out n.csv": "table.csv:1: columns 'plate_angle_deg,mass_flow_kg_s,force_n' of another program; no frame in",
    "monitor table.csv --once": "table.csv:1: columns 'plate_angle_deg,mass_flow_kg_s,force_n' of another program; no frame in",
    "replay table.csv -i virtual -c x": "table.csv:1: columns 'plate_angle_deg,mass_flow_kg_s,force_n' of another program; no frame in",
    "calibrate --loads table.csv --tickets tickets.csv": "table.csv:1: columns 'plate_angle_deg,mass_flow_kg_s,force_n' of another program;",
    "process plain.log.gz --out n.csv": "plain.log.gz:1: compressed data damaged:",
    "monitor plain.log.gz --once": "plain.log.gz:1: compressed data damaged:",
    "process torn.log.gz --out n.csv": "torn.log.gz: none of 330 frames is one that yieldmon takes in; expected a log with sensor,",
    "process logs.zip --out n.csv": "logs.zip: unknown log format; expected one of .log .asc .csv .trc .txt .blf .db .mf4",
    # tickets
    "calibrate --loads log.log --tickets latin.csv": "latin.csv: byte 31 is not UTF-8; expected a UTF-8 CSV file",
    "calibrate --loads log.log --tickets thousand.csv": "thousand.csv: line 2, weighed_kg: is '9,120'; expected a number",
    "calibrate --loads log.log --tickets with-unit.csv": "with-unit.csv: line 2, weighed_kg: is '9120kg'; expected a number",
    "calibrate --loads log.log --tickets two-units.csv": "two-units.csv: header: has weighed_kg and weighed_t; expected one column",
    "calibrate --loads log.log --tickets pipes.csv": "pipes.csv: header: has no column load; expected load: the number of a",
    "calibrate --loads log.log --tickets no-load.csv": "no-load.csv: line 2, load: is empty; expected the number of a load,",
    "calibrate --loads log.log --tickets title.csv": "title.csv: line 2: has 2 fields; expected 1, as in the header (a title above the",
    "calibrate --loads log.log --tickets title-in-cells.csv": "title-in-cells.csv: header: line 1 lacks 2 of 3 columns' names;",
    "calibrate --loads log.log --tickets quote.csv": "quote.csv: line 2: has 1 fields; expected 2, as in the header",
    "calibrate --loads log.log --tickets short.csv": "short.csv: line 2: has 2 fields; expected 3, as in the header",
    "calibrate --loads day.sqlite --tickets dated.csv": "dated.csv: line 2, load: is 2026-09-07, no load that was measured; expected",
    "calibrate --loads day.sqlite --tickets tonnes.csv": "tonnes.csv: line 2, load: load 1 weighs 1.21 kg, where 12",
    "calibrate --loads day.sqlite log.log --tickets tickets.csv": "--loads: names day.sqlite together with other sources; expected one store, or",
    "ticket 1 9,12t": "mass: '9,12t'; expected kilograms above 0, such as 9120, 9120kg, 9.12t or 20106lb, with a point, not a comma",
    "ticket 9-7 9120": "LOAD: '9-7'; expected the first load before the last, such as 7-9",
    # the set-up's answers
    "setup --out new --answers half.yaml": "half.yaml: has no home_plate_angle_deg; expected an answer to each question, or a",
    "setup --out new --answers null.yaml": "null.yaml: paddle_width_m: is None; expected 0.02 to 1 m",
    "setup --out new --answers inches.yaml": "inches.yaml: paddle_length_m: is 6.3; expected 0.02 to 1 m",
    "setup --out new --answers words.yaml": "words.yaml: cell_readings_mv: is and; expected -100000 to 100000 mV",
    "setup --out new --answers record.yaml": "record.yaml: is the record of a set-up; expected its answers alone, as in",
    "setup --out new --answers machine.yaml": "machine.yaml: name: is not asked; expected one of machine_name,",
    # fields and fleets
    "map field/points.csv --out new --date 23.11.2026": "--date: is '23.11.2026'; expected YYYY-MM-DD",
    "map field/points.csv --out new --width 100": "--width: is 100; expected 0.1 to 60",
    "map field/points.csv --out table.csv": "--out: table.csv is a file; expected a folder",
    "map field/points.csv --out new --products jpg": "--products: names 'jpg'; expected all, none or some of csv,",
    "map field/points.csv --out new --tickets tickets-cols.csv": "tickets-cols.csv: header: has no column load; expected load: the number",
    "fleet run tickets.csv --out new": "tickets.csv: header: has no column machine; expected machine, day, log",
    "fleet run twice-manifest.csv --out new": "twice-manifest.csv: line 3, log: names log.log a second time; expected each log",
    "fleet run slash.csv --out new": "slash.csv: line 2, machine: is 'a/b'; expected a name that begins with a letter or digit,",
    "fleet run folder --out new": "folder: holds no logs; expected folders MACHINE/DAY with logs in them",
    "fleet report folder": "folder: holds no partition; expected a dataset that `yieldmon fleet run` wrote",
    "web --listen 8090": "--listen: is '8090'; expected ADDRESS:PORT such as 127.0.0.1:8090 or 192.168.1.5:8090",
    "web --listen 0.0.0.0:8090": "--listen: 0.0.0.0 can be reached from other machines; expected --token-file with it,",
    "web --tiles diary.txt": "diary.txt: file is not a database; expected an MBTiles file with PNG, JPEG or WebP tiles",
}
