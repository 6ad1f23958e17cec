//! Large request bodies: the memory that all of them together may use, and the time that each may
//! take.
//!
//! Only the bytes of a body that have arrived are counted, not the length that its head announces:
//! a client that announces much and sends little takes no memory from others. A body that does not
//! fit is refused at once and its memory released, so that no body waits for another.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::Request;
use axum::http::StatusCode;
use futures_util::StreamExt;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::http::problem::Problem;

/// The memory for all bodies together, in bytes; the first [`FREE`] bytes of each are not counted.
const ALL: usize = 48 << 20;
/// Bytes of each body that always fit: an ordinary problem is smaller.
const FREE: usize = 256 << 10;
/// Bytes of a body that is too large which are read and discarded, so that its sender gets to read
/// the refusal.
const DRAINED: usize = 256 << 20;
/// How long a body may take to arrive.
const BODY_TIME: Duration = Duration::from_secs(60);
/// How long a body may stall.
const SILENCE: Duration = Duration::from_secs(10);

/// The remaining memory for bodies.
#[derive(Debug)]
pub(super) struct Bodies(Arc<Semaphore>);

/// A complete body, with the memory reserved for it until it is dropped.
#[derive(Debug)]
pub(super) struct HeldBody {
    pub(super) bytes: Vec<u8>,
    room: Option<OwnedSemaphorePermit>,
}

impl Bodies {
    pub(super) fn new() -> Self {
        Self(Arc::new(Semaphore::new(ALL)))
    }

    /// Reserves memory for `more` bytes of a body, whose length is then `length`.
    fn room(&self, length: usize, more: usize) -> Result<Option<OwnedSemaphorePermit>, Problem> {
        let counted = length.saturating_sub(FREE).min(more);
        let Ok(counted) = u32::try_from(counted) else { return Err(full()) };
        if counted == 0 {
            return Ok(None);
        }
        Arc::clone(&self.0).try_acquire_many_owned(counted).map(Some).map_err(|_| full())
    }
}

fn full() -> Problem {
    Problem::unavailable("the memory for request bodies is in use; send the request again")
}

/// Reads the body, of at most `limit` bytes, if it fits into the remaining memory.
///
/// # Errors
/// 413 for more than `limit`, 408 for one that does not arrive in time, 400 for one that is cut
/// off, 503 where `bodies` have no memory for it.
pub(super) async fn body(
    request: Request,
    limit: usize,
    bodies: Option<&Bodies>,
) -> Result<HeldBody, Problem> {
    let slow = |how: &str| {
        let detail = format!("the body did not arrive {how}; send the request again");
        Problem::new(StatusCode::REQUEST_TIMEOUT, detail)
    };
    tokio::time::timeout(BODY_TIME, async {
        let mut chunks = request.into_body().into_data_stream();
        let mut held = HeldBody { bytes: Vec::new(), room: None };
        let mut length = 0_usize;
        while let Some(chunk) = tokio::time::timeout(SILENCE, chunks.next())
            .await
            .map_err(|_| slow("further for ten seconds"))?
        {
            let cut = |error: axum::Error| {
                Problem::new(StatusCode::BAD_REQUEST, format!("the body was cut off: {error}"))
            };
            let chunk = chunk.map_err(cut)?;
            length += chunk.len();
            if length <= limit {
                held.append(&chunk, bodies)?;
            } else if length > DRAINED {
                break;
            } else {
                held = HeldBody { bytes: Vec::new(), room: None };
            }
        }
        if length > limit {
            let detail = format!(
                "the body is larger than {limit} bytes, the most that is read here; send less"
            );
            return Err(Problem::new(StatusCode::PAYLOAD_TOO_LARGE, detail));
        }
        Ok(held)
    })
    .await
    .map_err(|_| slow("within a minute"))?
}

impl HeldBody {
    fn append(&mut self, chunk: &[u8], bodies: Option<&Bodies>) -> Result<(), Problem> {
        if let Some(bodies) = bodies
            && let Some(more) = bodies.room(self.bytes.len() + chunk.len(), chunk.len())?
        {
            match &mut self.room {
                Some(room) => room.merge(more),
                None => self.room = Some(more),
            }
        }
        self.bytes.extend_from_slice(chunk);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Appends a body of `length` bytes piece by piece.
    fn held(bodies: &Bodies, length: usize) -> Result<HeldBody, Problem> {
        let mut held = HeldBody { bytes: Vec::new(), room: None };
        let piece = vec![0; 1 << 20];
        while held.bytes.len() < length {
            let next = piece.len().min(length - held.bytes.len());
            held.append(&piece[..next], Some(bodies))?;
        }
        Ok(held)
    }

    #[test]
    fn all_bodies_together_are_bounded_and_small_ones_always_have_room() {
        let bodies = Bodies::new();
        let large: Vec<HeldBody> =
            (0..6).map(|_| held(&bodies, 8 << 20)).collect::<Result<_, _>>().unwrap();
        assert_eq!(bodies.0.available_permits(), 6 * FREE);
        assert_eq!(held(&bodies, 8 << 20).unwrap_err().status(), 503);
        assert_eq!(bodies.0.available_permits(), 6 * FREE, "what came of it gave its room back");
        let small: Vec<HeldBody> = (0..100).map(|_| held(&bodies, FREE).unwrap()).collect();
        drop(large);
        assert_eq!(bodies.0.available_permits(), ALL);
        drop(small);
    }
}
