//! Large bodies: how much of memory all of them together may take, and how slow one may be.
//!
//! What of a body has come is counted, not what its head announces: a client that announces much
//! and sends little takes room from nobody. A body that finds no room is refused at once and its
//! memory given back, so that none ever waits for another.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::Request;
use axum::http::StatusCode;
use futures_util::StreamExt;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::http::problem::Problem;

/// All bodies together, in bytes: of which [`FREE`] of each are not counted.
const ALL: usize = 48 << 20;
/// So much of each body has room in any case, in bytes: an ordinary problem is smaller.
const FREE: usize = 256 << 10;
/// So much of a body that is too large is read and thrown away, so that its sender gets to read the
/// refusal.
const DRAINED: usize = 256 << 20;
/// How long a body may take to arrive.
const BODY_TIME: Duration = Duration::from_secs(60);
/// How long nothing of it may come.
const SILENCE: Duration = Duration::from_secs(10);

/// The room that there is for bodies.
#[derive(Debug)]
pub(super) struct Bodies(Arc<Semaphore>);

/// A body that has come to its end, and the room that it takes until it is dropped.
#[derive(Debug)]
pub(super) struct HeldBody {
    pub(super) bytes: Vec<u8>,
    room: Option<OwnedSemaphorePermit>,
}

impl Bodies {
    pub(super) fn new() -> Self {
        Self(Arc::new(Semaphore::new(ALL)))
    }

    /// Room for `more` bytes of a body whose length is then `length`.
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
    Problem::unavailable(
        "other requests' bodies take all the memory there is for them; send it again",
    )
}

/// The body, of at most `limit` bytes, in what room there is.
///
/// # Errors
/// 413 for more than `limit`, 408 for one that does not come to its end, 400 for one that is cut
/// off, 503 where `bodies` have no room for it.
pub(super) async fn body(
    request: Request,
    limit: usize,
    bodies: Option<&Bodies>,
) -> Result<HeldBody, Problem> {
    let slow = |how: &str| {
        let detail = format!("the body did not arrive {how}; send it again");
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
