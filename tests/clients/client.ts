// A client whose types openapi-typescript has generated: extracts, submits, follows and fetches.
//
//     client.js URL VOLUME

import assert from 'node:assert/strict'
import { createHash } from 'node:crypto'
import { setTimeout as pause } from 'node:timers/promises'
import createClient from 'openapi-fetch'
import type { components, paths } from './api.js'

const [url, volume] = process.argv.slice(2) as [string, string]
const client = createClient<paths>({ baseUrl: url })

const volumes = await client.GET('/api/v1/volumes')
assert.ok(volumes.data?.some(({ id }) => id === volume))

const wanted: components['schemas']['FileRequest'] = { iso: 100, triangles: { share: 0.05 }, format: 'stl' }
const posted = await client.POST('/api/v1/extract', { body: { volume, ...wanted }, parseAs: 'arrayBuffer' })
assert.ok(posted.data, JSON.stringify(posted.error))
const bytes = Buffer.from(posted.data)
const triangles = bytes.readUInt32LE(80)
assert.ok(triangles > 100 && bytes.length === 84 + 50 * triangles)

const refused = await client.POST('/api/v1/extract', { body: { volume, iso: 1e6, format: 'stl' }, parseAs: 'arrayBuffer' })
assert.equal(refused.error?.code, 'empty-surface')

const submitted = await client.POST('/api/v1/jobs', { body: { volume, extractions: [wanted, { ...wanted, iso: 1e6 }] } })
let job = submitted.data
assert.ok(job, JSON.stringify(submitted.error))
const path = { id: job.id }
// The stream of events ends with the job.
const events = await client.GET('/api/v1/jobs/{id}/events', { params: { path }, parseAs: 'text' })
assert.match(String(events.data), /event: ?done/)
for (let tries = 0; job.state !== 'done'; tries += 1) {
  assert.ok(tries < 100, job.state)
  await pause(50)
  const shown = await client.GET('/api/v1/jobs/{id}', { params: { path } })
  assert.ok(shown.data)
  job = shown.data
}
assert.equal(job.extractions.empty, 1)
const results = await client.GET('/api/v1/jobs/{id}/results', { params: { path } })
const [first, second] = results.data ?? []
assert.equal(second?.problem?.code, 'empty-surface')
const fetched = await client.GET('/api/v1/jobs/{id}/results/{extraction}', { params: { path: { ...path, extraction: 0 } }, parseAs: 'arrayBuffer' })
assert.ok(fetched.data)
assert.equal(createHash('sha256').update(Buffer.from(fetched.data)).digest('hex'), first?.sha256)
assert.equal((await client.DELETE('/api/v1/jobs/{id}', { params: { path } })).response.status, 204)
console.log(triangles)
