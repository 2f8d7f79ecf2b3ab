// Reads a zipped task data set with the npm package isoxml and prints what it finds as JSON.
const { readFileSync } = require('fs')
const { ISOXMLManager } = require('isoxml')

const manager = new ISOXMLManager()
manager.parseISOXMLFile(new Uint8Array(readFileSync(process.argv[2])), 'application/zip').then(() => {
  const root = manager.rootElement.attributes
  const task = root.Task[0]
  const log = task.attributes.TimeLog[0].parseBinaryFile()
  const plain = (key, value) => (key === 'entity' || key === 'isoxmlManager' ? undefined : value)
  console.log(JSON.stringify({
    warnings: manager.getWarnings(),
    field: root.Partfield[0].attributes,
    status: task.attributes.TaskStatus,
    totals: task.attributes.Time[0].attributes.DataLogValue.map(value => value.attributes),
    valuesInfo: log.valuesInfo,
    records: log.timeLogs,
    errors: task.attributes.TimeLog[0].parsingErrors,
  }, plain))
}).catch(error => { console.error(error); process.exit(1) })
