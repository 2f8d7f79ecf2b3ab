"""The monitor without a bus: a virtual combine's frames in, results out, answers back to the combine."""

from yieldmon import api

loaded = api.load_configuration(api.shipped("config/yieldmon.yaml"))
monitor = api.build_monitor(loaded.engine, loaded.machine, loaded.parameters)
combine = api.VirtualCombine(api.load_scenario(api.shipped("config/scenarios/steady.yaml")), loaded.machine, 1)
for frame in combine.frames_until(40.0):
    for result in monitor.feed(frame):
        for answer in result.frames:
            combine.handle(answer)
        if isinstance(result, api.WindowResult) and result.record.mass_flow_kg_s is not None:
            print(f"{result.record.time_s:6.1f} s  {result.record.mass_flow_kg_s:6.2f} kg/s")
