//! The OpenAPI 3.1 document, generated from the descriptions of the routes.

use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityScheme};
use utoipa::openapi::{ContentBuilder, Ref, Response, ResponseBuilder};
use utoipa::{Modify, OpenApi};

use crate::http::{
    board, calibrations, cameras, events, focus, frames, health, recordings, rigs, sessions, solve,
    target, uncertainty, views,
};

#[derive(OpenApi)]
#[openapi(
    info(
        title = "Plumb",
        description = "Detects calibration boards in live images, calibrates cameras, and states the uncertainty of the result. \
            Pixels: x right, y down, integer coordinates are pixel centers. Units: meters, radians, seconds, pixels."
    ),
    paths(
        health::healthz,
        health::readyz,
        health::metrics,
        cameras::list,
        cameras::one,
        frames::frame,
        frames::preview,
        focus::focus,
        target::in_view,
        rigs::list,
        rigs::one,
        rigs::start,
        rigs::calibration,
        rigs::calibrations,
        sessions::start,
        sessions::list,
        sessions::one,
        sessions::stop,
        sessions::abort,
        views::list,
        views::view_image,
        calibrations::current,
        calibrations::history,
        calibrations::stated,
        calibrations::one,
        calibrations::approve,
        calibrations::delete_calibration,
        uncertainty::numbers,
        uncertainty::uncertainty_image,
        uncertainty::session_image,
        board::board_image,
        solve::solve,
        recordings::start,
        recordings::list,
        recordings::one,
        recordings::stop,
        recordings::delete_recording,
        events::follow,
    ),
    components(schemas(
        events::FrameEventDocument<'_>,
        events::DetectionEventDocument<'_>,
        events::CalibrationEventDocument<'_>,
        events::DriftEventDocument<'_>,
    )),
    modifiers(&GateRefusals),
    security((), ("bearer" = [])),
    tags(
        (name = "cameras", description = "the configured cameras and what they see"),
        (name = "rigs", description = "cameras that are fixed to each other"),
        (name = "sessions", description = "collecting views towards a calibration"),
        (name = "calibrations", description = "results, their history and their approval"),
        (name = "recordings", description = "frames on the daemon's disk"),
        (name = "events", description = "what happens, as it happens"),
        (name = "daemon", description = "health and figures")
    )
)]
struct Description;

/// What every operation may answer before it is asked, and how a client is known.
struct GateRefusals;

/// The errors that the daemon may answer for any operation: status, and reason.
const REFUSALS: [(&str, &str); 6] = [
    ("400", "no `Host` header or several, or a malformed query"),
    ("401", "no token, or one that is not known"),
    ("403", "the token's role does not permit this, or the request is cross-site"),
    ("421", "the host name is neither localhost nor an IP address, and no token is configured"),
    ("429", "too many wrong tokens"),
    ("503", "too many connections, or the daemon is stopping"),
];

impl Modify for GateRefusals {
    fn modify(&self, document: &mut utoipa::openapi::OpenApi) {
        let scheme = HttpBuilder::new()
            .scheme(HttpAuthScheme::Bearer)
            .description(Some("A token that `plumb token add` made, where the daemon has tokens."))
            .build();
        let components = document.components.get_or_insert_default();
        components.add_security_scheme("bearer", SecurityScheme::Http(scheme));
        let operations = document.paths.paths.iter_mut().flat_map(|(_, item)| {
            [&mut item.get, &mut item.post, &mut item.delete].into_iter().flatten()
        });
        for operation in operations {
            for (status, why) in REFUSALS {
                let of_status = operation.responses.responses.entry(status.to_owned());
                of_status.or_insert_with(|| refusal(why).into());
            }
        }
    }
}

fn refusal(why: &str) -> Response {
    let schema = Ref::from_schema_name("Problem");
    let content = ContentBuilder::new().schema(Some(schema)).build();
    ResponseBuilder::new().description(why).content("application/problem+json", content).build()
}

/// The OpenAPI document.
pub(super) fn document() -> utoipa::openapi::OpenApi {
    Description::openapi()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_operation_has_a_name_of_its_own() {
        let document = serde_json::to_value(document()).unwrap();
        let paths = document["paths"].as_object().unwrap().values();
        let operations = paths.flat_map(|path| path.as_object().unwrap().values());
        let mut names: Vec<&str> =
            operations.map(|operation| operation["operationId"].as_str().unwrap()).collect();
        names.sort_unstable();
        assert!(names.len() > 20 && names.windows(2).all(|pair| pair[0] != pair[1]), "{names:?}");
    }
}
