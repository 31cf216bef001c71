//! The scene: many instances of many meshes, lights, ambient, environment and background.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{DAffine3, DVec3};

use super::assemblies::{Assembly, Dressed, Owners, fitting};
use super::environment::Environment;
use super::light::Light;
use super::material::Materials;
use super::placement::Placement;
use super::pose;
use super::slots::{Handle, Slots};
use crate::error::{Error, Result};
use crate::math::singular_value_bound;
use crate::model::{Dag, Primitive};

/// Names an instance of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct InstanceHandle(pub Handle);

/// Names a light of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LightHandle(pub Handle);

/// A mesh in the scene. The mesh itself is shared.
#[derive(Clone, Debug)]
pub struct Instance {
    /// The mesh.
    pub mesh: Arc<Dag>,
    /// Its look.
    pub materials: Materials,
    /// What it is an instance of, where that is an assembly: the mesh and the look are those that stand for it.
    pub assembly: Option<Arc<Assembly>>,
    /// False hides it.
    pub visible: bool,
    casts_shadows: bool,
    receives_shadows: bool,
    pose: DAffine3,
    /// Bound of the largest singular value of the pose's linear part.
    scale: f64,
    /// A sphere around the instance in the world: centre and radius.
    sphere: (DVec3, f64),
    placement: Placement,
}

impl Instance {
    /// At a pose, to be seen, with shadows.
    fn new(Dressed { mesh, materials }: Dressed, pose: DAffine3) -> Self {
        let mut instance = Self {
            mesh,
            materials,
            assembly: None,
            visible: true,
            casts_shadows: true,
            receives_shadows: true,
            pose: DAffine3::IDENTITY,
            scale: 1.0,
            sphere: (DVec3::ZERO, 0.0),
            placement: Placement::default(),
        };
        instance.set_pose(pose);
        instance
    }

    /// A part of an instance of an assembly, at a pose in the world.
    pub fn part(owner: &Self, what: &Dressed, pose: DAffine3) -> Self {
        let Self { casts_shadows, receives_shadows, .. } = *owner;
        Self { casts_shadows, receives_shadows, ..Self::new(what.clone(), pose) }
    }

    /// Whether it is that part.
    pub fn is_part(&self, owner: &Self, what: &Dressed, pose: &DAffine3) -> bool {
        self.pose == *pose
            && Arc::ptr_eq(&self.mesh, &what.mesh)
            && self.shadows() == owner.shadows()
            && self.materials.is(&what.materials)
    }

    /// Where it would be at another pose.
    pub fn placement_at(&self, pose: &DAffine3) -> Placement {
        let scale = singular_value_bound(pose::linear_rows(&pose.matrix3));
        Placement::new(pose, &self.mesh.frame, self.mesh.rounding(), scale)
    }

    /// Object to world.
    pub fn pose(&self) -> &DAffine3 {
        &self.pose
    }

    /// An upper bound of how much the pose stretches any length.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// A sphere around the instance, world space: centre and radius.
    pub fn sphere(&self) -> (DVec3, f64) {
        self.sphere
    }

    /// Where it is, in the precision of the stages.
    pub fn placement(&self) -> &Placement {
        &self.placement
    }

    /// Whether what is behind it may be seen through it.
    pub fn blends(&self) -> bool {
        self.materials.any_blended(self.mesh.layout().colors.is_some())
    }

    /// Whether it consists of triangles, and not of points or lines.
    pub fn is_ordinary(&self) -> bool {
        self.mesh.primitive == Primitive::Triangles
    }

    /// Whether it throws shadows, where frames have such. Points and lines throw none.
    pub fn casts_shadows(&self) -> bool {
        self.casts_shadows && self.is_ordinary()
    }

    /// Whether shadows fall on it.
    pub fn receives_shadows(&self) -> bool {
        self.receives_shadows && self.is_ordinary()
    }

    /// What it was told of both.
    pub fn shadows(&self) -> (bool, bool) {
        (self.casts_shadows, self.receives_shadows)
    }

    /// Whether it shows what no device draws: what is blended, points and lines.
    pub fn needs_cpu(&self) -> bool {
        self.visible && (self.blends() || !self.is_ordinary())
    }

    fn set_pose(&mut self, pose: DAffine3) {
        self.pose = pose;
        self.scale = singular_value_bound(pose::linear_rows(&pose.matrix3));
        let (frame, bounds) = (&self.mesh.frame, &self.mesh.bounds);
        let center = pose.transform_point3(DVec3::from_array(frame.to_object(bounds.center())));
        let radius = 0.5 * f64::from(bounds.diagonal()) * frame.scale * self.scale;
        self.sphere = (center, radius * (1.0 + 1.0e-6));
        self.placement = Placement::new(&pose, frame, self.mesh.rounding(), self.scale);
    }
}

/// Number of the next scene.
static NEXT: AtomicU64 = AtomicU64::new(0);

/// Everything that is drawn. Every edit touches the one entry it names.
#[derive(Debug)]
pub struct Scene {
    /// No two scenes have the same.
    identity: u64,
    /// The scene that it follows, see [`Scene::follow`].
    followed: Option<u64>,
    instances: Slots<Instance>,
    /// Instances that the CPU alone draws.
    need_cpu: usize,
    /// Instances of assemblies.
    assemblies: usize,
    owners: Arc<Owners>,
    lights: Slots<Light>,
    ambient_light: [f32; 3],
    bg_color: [f32; 3],
    environment: Option<Environment>,
}

impl Clone for Scene {
    fn clone(&self) -> Self {
        Self {
            identity: NEXT.fetch_add(1, Ordering::Relaxed),
            followed: None,
            instances: self.instances.clone(),
            owners: Arc::clone(&self.owners),
            lights: self.lights.clone(),
            environment: self.environment.clone(),
            ..*self
        }
    }
}

impl Default for Scene {
    fn default() -> Self {
        Self {
            identity: NEXT.fetch_add(1, Ordering::Relaxed),
            followed: None,
            instances: Slots::new("instance"),
            need_cpu: 0,
            assemblies: 0,
            owners: Arc::default(),
            lights: Slots::new("light"),
            ambient_light: [0.0; 3],
            bg_color: [1.0; 3],
            environment: None,
        }
    }
}

impl Scene {
    /// An empty scene: white background, no light at all.
    pub fn new() -> Self {
        Self::default()
    }

    /// A number that no other scene has, not even a copy.
    pub fn identity(&self) -> u64 {
        self.identity
    }

    /// Adds an instance of a mesh at an object-to-world pose.
    pub fn add(
        &mut self,
        mesh: Arc<Dag>,
        pose: &[[f64; 4]; 4],
        materials: impl Into<Materials>,
    ) -> Result<InstanceHandle> {
        self.insert(Instance::new(Dressed::new(mesh, materials)?, pose::affine("pose", pose)?))
    }

    /// Adds an instance of an assembly at an object-to-world pose.
    pub fn add_assembly(&mut self, assembly: Arc<Assembly>, pose: &[[f64; 4]; 4]) -> Result<InstanceHandle> {
        let instance = Instance::new(assembly.far.clone(), pose::affine("pose", pose)?);
        self.insert(Instance { assembly: Some(assembly), ..instance })
    }

    fn insert(&mut self, instance: Instance) -> Result<InstanceHandle> {
        let (needs_cpu, assembly) = (instance.needs_cpu(), instance.assembly.is_some());
        let handle = self.instances.insert(instance)?;
        self.need_cpu += usize::from(needs_cpu);
        self.assemblies += usize::from(assembly);
        Ok(InstanceHandle(handle))
    }

    /// Instances of assemblies.
    pub fn assemblies(&self) -> usize {
        self.assemblies
    }

    /// A number that follows an instance from frame to frame, in scenes that follow each other, too.
    pub fn origin(&self) -> u64 {
        self.followed.unwrap_or(self.identity)
    }

    /// Becomes what another scene is, but for slots that [`Scene::put`] fills behind those of the other. Returns the clock to
    /// give the next time; 0 is right the first time, in an empty scene.
    pub fn follow(&mut self, other: &Self, since: u64) -> u64 {
        self.followed = Some(other.identity);
        for (slot, instance) in other.instances.changed_since(since) {
            self.put(other.instances.handle(slot), instance.cloned());
        }
        if self.lights.clock() != other.lights.clock() {
            self.lights = other.lights.clone();
        }
        (self.ambient_light, self.bg_color) = (other.ambient_light, other.bg_color);
        self.environment.clone_from(&other.environment);
        other.instances.clock()
    }

    /// Puts an instance, or nothing, in a slot of a scene that follows another.
    pub fn put(&mut self, at: Handle, instance: Option<Instance>) {
        let counts = |instance: Option<&Instance>| {
            instance.map_or((0, 0), |i| (usize::from(i.needs_cpu()), usize::from(i.assembly.is_some())))
        };
        let (old, new) = (counts(self.instances.at(at.index as usize)), counts(instance.as_ref()));
        self.need_cpu = self.need_cpu + new.0 - old.0;
        self.assemblies = self.assemblies + new.1 - old.1;
        self.instances.put(at, instance);
    }

    /// Which instances are parts of which.
    pub fn owners(&self) -> &Arc<Owners> {
        &self.owners
    }

    /// Says which instances are parts of which.
    pub fn set_owners(&mut self, owners: Arc<Owners>) {
        self.owners = owners;
    }

    /// Whether there is anything that the CPU alone draws.
    pub fn needs_cpu(&self) -> bool {
        self.need_cpu > 0
    }

    /// Changes what an instance shows.
    fn change_look(&mut self, handle: InstanceHandle, change: impl FnOnce(&mut Instance)) -> Result<()> {
        let instance = self.instances.get_mut(handle.0)?;
        let before = instance.needs_cpu();
        change(instance);
        self.need_cpu = self.need_cpu + usize::from(instance.needs_cpu()) - usize::from(before);
        Ok(())
    }

    /// An instance.
    pub fn instance(&self, handle: InstanceHandle) -> Result<&Instance> {
        self.instances.get(handle.0)
    }

    /// Moves an instance.
    pub fn set_pose(&mut self, handle: InstanceHandle, pose: &[[f64; 4]; 4]) -> Result<()> {
        let pose = pose::affine("pose", pose)?;
        self.instances.get_mut(handle.0)?.set_pose(pose);
        Ok(())
    }

    /// Gives an instance another geometry, where it is.
    pub fn set_mesh(&mut self, handle: InstanceHandle, mesh: Arc<Dag>) -> Result<()> {
        let instance = self.instances.get(handle.0)?;
        if instance.assembly.is_some() {
            return Err(Error::argument("mesh", "an instance of an assembly has none of its own"));
        }
        fitting(instance.materials.clone(), &mesh)?;
        self.change_look(handle, |instance| {
            instance.mesh = mesh;
            instance.set_pose(instance.pose);
        })
    }

    /// Shows or hides an instance.
    pub fn set_visible(&mut self, handle: InstanceHandle, visible: bool) -> Result<()> {
        self.change_look(handle, |instance| instance.visible = visible)
    }

    /// Whether an instance throws shadows, and whether they fall on it.
    pub fn set_shadows(&mut self, handle: InstanceHandle, casts: bool, receives: bool) -> Result<()> {
        let instance = self.instances.get_mut(handle.0)?;
        (instance.casts_shadows, instance.receives_shadows) = (casts, receives);
        Ok(())
    }

    /// Changes the look of an instance.
    pub fn set_material(&mut self, handle: InstanceHandle, materials: impl Into<Materials>) -> Result<()> {
        let instance = self.instances.get(handle.0)?;
        if instance.assembly.is_some() {
            return Err(Error::argument("material", "the parts of an assembly have their own"));
        }
        let materials = fitting(materials.into(), &instance.mesh)?;
        self.change_look(handle, |instance| instance.materials = materials)
    }

    /// Removes an instance; its handle is stale from now on.
    pub fn remove(&mut self, handle: InstanceHandle) -> Result<Instance> {
        let instance = self.instances.remove(handle.0)?;
        self.need_cpu -= usize::from(instance.needs_cpu());
        self.assemblies -= usize::from(instance.assembly.is_some());
        Ok(instance)
    }

    /// All instances with their slot numbers, in slot order: the scene order.
    pub fn instances(&self) -> &Slots<Instance> {
        &self.instances
    }

    /// Adds a light.
    pub fn add_light(&mut self, light: Light) -> Result<LightHandle> {
        light.validate()?;
        Ok(LightHandle(self.lights.insert(light)?))
    }

    /// A light.
    pub fn light(&self, handle: LightHandle) -> Result<&Light> {
        self.lights.get(handle.0)
    }

    /// Replaces a light.
    pub fn set_light(&mut self, handle: LightHandle, light: Light) -> Result<()> {
        light.validate()?;
        *self.lights.get_mut(handle.0)? = light;
        Ok(())
    }

    /// Removes a light; its handle is stale from now on.
    pub fn remove_light(&mut self, handle: LightHandle) -> Result<Light> {
        self.lights.remove(handle.0)
    }

    /// All lights, in slot order.
    pub fn lights(&self) -> &Slots<Light> {
        &self.lights
    }

    /// Constant light on every surface, linear RGB.
    pub fn ambient_light(&self) -> [f32; 3] {
        self.ambient_light
    }

    /// Sets the ambient light.
    pub fn set_ambient_light(&mut self, color: [f32; 3]) -> Result<()> {
        self.ambient_light = finite("ambient_light", color)?;
        Ok(())
    }

    /// Colour of pixels that nothing covers, 0 to 1, not gamma-encoded.
    pub fn bg_color(&self) -> [f32; 3] {
        self.bg_color
    }

    /// Sets the background colour.
    pub fn set_bg_color(&mut self, color: [f32; 3]) -> Result<()> {
        self.bg_color = finite("bg_color", color)?;
        Ok(())
    }

    /// The environment map.
    pub fn environment(&self) -> Option<&Environment> {
        self.environment.as_ref()
    }

    /// Sets the environment, or takes it away.
    pub fn set_environment(&mut self, environment: Option<Environment>) -> Result<()> {
        environment.as_ref().map_or(Ok(()), Environment::validate)?;
        self.environment = environment;
        Ok(())
    }
}

fn finite(argument: &'static str, color: [f32; 3]) -> Result<[f32; 3]> {
    match color.iter().find(|c| !(c.is_finite() && **c >= 0.0)) {
        Some(bad) => Err(Error::argument(argument, format!("must be finite and not negative, not {bad}"))),
        None => Ok(color),
    }
}
