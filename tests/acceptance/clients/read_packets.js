// Decodes raw MAVLink packets with node-mavlink: `node read_packets.js FILE`, an object of JSON per packet and one
// with the counts at the end.
const { createReadStream } = require('fs')
const { MavLinkPacketParser, MavLinkPacketSplitter, minimal, common, ardupilotmega } = require('node-mavlink')

const REGISTRY = { ...minimal.REGISTRY, ...common.REGISTRY, ...ardupilotmega.REGISTRY }
const splitter = new MavLinkPacketSplitter({}, { onCrcError: () => {} })

// JSON has neither integers of 64 bits nor numbers that are none.
const plain = (_, value) =>
  typeof value === 'bigint' ? value.toString()
    : typeof value === 'number' && !Number.isFinite(value) ? String(value) : value

createReadStream(process.argv[2])
  .pipe(splitter)
  .pipe(new MavLinkPacketParser())
  .on('data', packet => {
    const { msgid, seq, sysid, compid } = packet.header
    const kind = REGISTRY[msgid]
    const values = kind ? packet.protocol.data(packet.payload, kind) : null
    console.log(JSON.stringify({ msgid, seq, sysid, compid, name: kind ? kind.MSG_NAME : null, values }, plain))
  })
  .on('end', () => {
    const { validPackages, invalidPackages, unknownPackagesCount } = splitter
    console.log(JSON.stringify({ valid: validPackages, invalid: invalidPackages, unknown: unknownPackagesCount }))
  })
