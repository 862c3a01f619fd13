// An issuer of OpenID Connect in which everybody is Ada: the code that it takes is the nonce of a sign-in.

import { generateKeyPairSync, sign } from 'node:crypto'
import { once } from 'node:events'
import { createServer } from 'node:http'
import { text } from 'node:stream/consumers'

const KEY = 'one'

function idToken(privateKey, claims) {
  const encoded = part => Buffer.from(JSON.stringify(part)).toString('base64url')
  const message = `${encoded({ alg: 'RS256', kid: KEY })}.${encoded(claims)}`
  return `${message}.${sign('sha256', Buffer.from(message), privateKey).toString('base64url')}`
}

/** Starts it for a client's id; returns the server and its address. */
export async function startIssuer(client) {
  const { publicKey, privateKey } = generateKeyPairSync('rsa', { modulusLength: 2048 })
  const server = createServer(async (request, response) => {
    const answer = body => response.setHeader('content-type', 'application/json').end(JSON.stringify(body))
    if (request.url === '/.well-known/openid-configuration') {
      answer({ issuer, authorization_endpoint: `${issuer}/authorize`, token_endpoint: `${issuer}/token`, jwks_uri: `${issuer}/keys` })
    } else if (request.url === '/keys') {
      answer({ keys: [{ ...publicKey.export({ format: 'jwk' }), kid: KEY, use: 'sig' }] })
    } else if (request.url === '/token') {
      const nonce = new URLSearchParams(await text(request)).get('code')
      const now = Math.floor(Date.now() / 1000)
      answer({ id_token: idToken(privateKey, { iss: issuer, aud: client, sub: 'ada', nonce, iat: now, exp: now + 60 }) })
    } else {
      response.writeHead(404).end()
    }
  })
  server.listen(0, '127.0.0.1')
  await once(server, 'listening')
  const issuer = `http://127.0.0.1:${server.address().port}`
  return { server, issuer }
}
