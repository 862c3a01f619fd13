// A client whose types openapi-typescript has generated: every operation.
//
//     client.js URL VOLUME TOKEN DESCRIPTION      # the description is openapi.json

import assert from 'node:assert/strict'
import { createHash } from 'node:crypto'
import { readFileSync } from 'node:fs'
import { setTimeout as pause } from 'node:timers/promises'
import createClient, { type Middleware } from 'openapi-fetch'
import type { components, paths } from './api.js'

const [url, volume, token, description] = process.argv.slice(2) as [string, string, string, string]
const used = new Set<string>()
const recorder: Middleware = {
  onRequest({ request, schemaPath }) {
    used.add(`${request.method} ${schemaPath}`)
  },
}

function clientOf(headers: Record<string, string>) {
  const client = createClient<paths>({ baseUrl: url, headers, redirect: 'manual' })
  client.use(recorder)
  return client
}

/** The body of an answer, which is no problem. */
function body<T>(answer: { data?: T; error?: unknown }): NonNullable<T> {
  assert.ok(answer.data !== undefined && answer.data !== null, JSON.stringify(answer.error))
  return answer.data
}

const client = clientOf({ authorization: `Bearer ${token}` })
const stranger = clientOf({})

async function extracts(): Promise<number> {
  const wanted: components['schemas']['FileRequest'] = { iso: 100, triangles: { share: 0.05 }, format: 'stl' }
  const posted = Buffer.from(body(await client.POST('/api/v1/extract', { body: { volume, ...wanted }, parseAs: 'arrayBuffer' })))
  const triangles = posted.readUInt32LE(80)
  assert.ok(triangles > 100 && posted.length === 84 + 50 * triangles)
  const query = { volume, format: 'stl', iso: 100 } as const
  const whole = body(await client.GET('/api/v1/extract', { params: { query }, parseAs: 'arrayBuffer' }))
  assert.ok(whole.byteLength > posted.length)
  const refused = await client.POST('/api/v1/extract', { body: { volume, iso: 1e6, format: 'stl' }, parseAs: 'arrayBuffer' })
  assert.equal(refused.error?.code, 'empty-surface')

  let job = body(await client.POST('/api/v1/jobs', { body: { volume, extractions: [wanted, { ...wanted, iso: 1e6 }] } }))
  const path = { id: job.id }
  // The stream of events ends with the job.
  assert.match(body(await client.GET('/api/v1/jobs/{id}/events', { params: { path }, parseAs: 'text' })), /event: ?done/)
  for (let tries = 0; job.state !== 'done'; tries += 1) {
    assert.ok(tries < 100, job.state)
    await pause(50)
    job = body(await client.GET('/api/v1/jobs/{id}', { params: { path } }))
  }
  assert.equal(job.extractions.empty, 1)
  const [first, second] = body(await client.GET('/api/v1/jobs/{id}/results', { params: { path } }))
  assert.equal(second?.problem?.code, 'empty-surface')
  const result = { params: { path: { ...path, extraction: 0 } }, parseAs: 'arrayBuffer' } as const
  const fetched = Buffer.from(body(await client.GET('/api/v1/jobs/{id}/results/{extraction}', result)))
  assert.equal(createHash('sha256').update(fetched).digest('hex'), first?.sha256)
  const listed = body(await client.GET('/api/v1/jobs'))
  assert.ok(listed.some(({ id }) => id === job.id))
  const other = body(await client.POST('/api/v1/jobs', { body: { volume, extractions: Array.from({ length: 20 }, () => wanted) } }))
  body(await client.POST('/api/v1/jobs/{id}/cancel', { params: { path: { id: other.id } } }))
  assert.equal((await client.DELETE('/api/v1/jobs/{id}', { params: { path } })).response.status, 204)
  return triangles
}

async function asksOfVolumes() {
  assert.ok(body(await client.GET('/api/v1/volumes')).some(({ id }) => id === volume))
  const path = { id: volume }
  const info = body(await client.GET('/api/v1/volumes/{id}', { params: { path } }))
  assert.ok(info.fields.length > 0)
  const field = body(await client.GET('/api/v1/volumes/{id}/expression', { params: { path, query: { expression: '2 * t1' } } }))
  assert.ok('range' in field, JSON.stringify(field))
  const query = { axis: 'z', index: 20, format: 'nii' } as const
  const plane = Buffer.from(body(await client.GET('/api/v1/volumes/{id}/slices', { params: { path, query }, parseAs: 'arrayBuffer' })))
  assert.equal(plane.subarray(344, 347).toString(), 'n+1')
  assert.ok(body(await client.GET('/api/v1/volumes/{id}/overview', { params: { path }, parseAs: 'arrayBuffer' })).byteLength > 1000)
  assert.deepEqual(body(await client.GET('/api/v1/unreadable')), [])
}

async function uploads() {
  const header = 'NRRD0004\ntype: uint8\ndimension: 3\nsizes: 4 4 4\nencoding: raw\n\n'
  const content = header + String.fromCharCode(...Array(64).keys())
  const upload = body(await client.POST('/api/v1/uploads', { body: { files: [{ name: 'ramp.nrrd', bytes: content.length }] } }))
  const path = { id: upload.id }
  const sent = await client.PATCH('/api/v1/uploads/{id}', {
    params: { path, header: { 'upload-offset': 0, 'tus-resumable': '1.0.0' } },
    headers: { 'content-type': 'application/offset+octet-stream' },
    body: content,
    bodySerializer: bytes => bytes,
  })
  assert.equal(sent.response.status, 204, JSON.stringify(sent.error))
  const { response } = await client.HEAD('/api/v1/uploads/{id}', { params: { path } })
  assert.equal(response.headers.get('upload-offset'), `${content.length}`)
  body(await client.POST('/api/v1/uploads/{id}/finish', { params: { path } }))
  assert.equal(body(await client.GET('/api/v1/uploads/{id}', { params: { path } })).id, upload.id)
  assert.ok(body(await client.GET('/api/v1/uploads')).uploads.some(({ id }) => id === upload.id))
  assert.equal((await client.DELETE('/api/v1/uploads/{id}', { params: { path } })).response.status, 204)
}

async function watches() {
  assert.ok(body(await stranger.GET('/healthz', { parseAs: 'text' })) && body(await stranger.GET('/readyz', { parseAs: 'text' })))
  assert.match(body(await client.GET('/metrics', { parseAs: 'text' })), /isopeel_/)
  body(await client.GET('/api/v1/memory'))
  assert.deepEqual(body(await client.GET('/api/v1/devices')).map(({ device, state }) => [device, state]), [[0, 'ready']])
}

/** The cookies of an answer, for the next request. */
const cookies = ({ headers }: Response) => headers.getSetCookie().map(cookie => cookie.split(';')[0]).join('; ')

async function signsIn() {
  assert.deepEqual(body(await stranger.GET('/api/v1/embed')).origins, [])
  assert.equal((await stranger.GET('/api/v1/session')).error?.code, 'unauthorized')
  const begun = await stranger.POST('/api/v1/session', { body: { token } })
  assert.equal(begun.response.status, 204)
  // Changes by a cookie need the page that they come from.
  const page = clientOf({ cookie: cookies(begun.response), origin: url })
  assert.ok(body(await page.GET('/api/v1/session')).roles.includes('admin'))
  assert.ok(body(await page.POST('/api/v1/tickets')).ticket)
  body(await page.DELETE('/api/v1/session'))

  const lent = body(await client.POST('/api/v1/embed-tokens', { body: { roles: ['view'], seconds: 60 } }))
  const frame = clientOf({ authorization: `Bearer ${lent.token}` })
  assert.deepEqual(body(await frame.GET('/api/v1/session')).roles, ['view'])

  assert.ok(body(await stranger.GET('/api/v1/oidc')).signIn)
  const leave = await stranger.GET('/api/v1/oidc/login')
  assert.equal(leave.response.status, 303)
  const asked = new URL(leave.response.headers.get('location') ?? '').searchParams
  const browser = clientOf({ cookie: cookies(leave.response) })
  const query = { code: asked.get('nonce') ?? '', state: asked.get('state') ?? '' }
  const back = await browser.GET('/api/v1/oidc/callback', { params: { query } })
  assert.deepEqual([back.response.status, back.response.headers.get('location')], [303, `${url}/`])
  const ada = clientOf({ cookie: cookies(back.response) })
  assert.deepEqual(body(await ada.GET('/api/v1/session')).roles, ['view'])
}

await asksOfVolumes()
const triangles = await extracts()
await uploads()
await watches()
await signsIn()

const document = JSON.parse(readFileSync(description, 'utf8')) as { paths: Record<string, Record<string, { operationId?: string }>> }
const all = Object.entries(document.paths).flatMap(([path, item]) => {
  const operations = Object.entries(item).filter(([, { operationId }]) => operationId !== undefined)
  return operations.map(([method]) => `${method.toUpperCase()} ${path}`)
})
assert.deepEqual(all.filter(operation => !used.has(operation)), [], 'operations that were not used')
console.log(triangles)
